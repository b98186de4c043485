"""The installed program streaming on a Windows PC that is a computer of the network."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import replace
from types import TracebackType
from typing import Self

from tests.rigs.hosts.lan import Host
from tests.rigs.priority import before_others
from tests.rigs.windows.pc import WindowsPc
from tests.rigs.windows.program import RunningProgram

_TAIL = 4000
# Empty is unset for Windows: the program uses its user's own folders.
_OWN_PLACES = {"BIOSENSOR_GATEWAY_SETTINGS": "", "BIOSENSOR_GATEWAY_STATE": ""}


class InstalledAgent:
    """``biosensor-gateway run`` of a PC; a context manager.

    Leaving it ends the program by its own ``stop``, and then all that runs on the PC.

    Parameters
    ----------
    pc
        Has the program and its settings; what runs on it already is ended.
    host
        The computer of the network that it is; Wine's server starts there with the first
        program, and the sockets of all of them are the server's.
    environment
        More variables for all its programs, as Windows is to see them.

    Raises
    ------
    AssertionError
        On leaving, if it does not end with exit code 0.
    """

    def __init__(self, pc: WindowsPc, host: Host, environment: Mapping[str, str]) -> None:
        self._pc = pc
        self._prefix = replace(
            pc.prefix, environment={**environment, **_OWN_PLACES}, before=tuple(host.command())
        )

    def __enter__(self) -> Self:
        self._prefix.end()
        self._program = RunningProgram(self._prefix, self._pc.program, self._pc.user_folder)
        # It starts Wine's server, which so has the same priority.
        before_others(self._program.pid)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._program:
            stopped = self.gateway("stop")
            code = self._program.exit_code()
            # The services of this Windows have the program's outputs, too.
            self._prefix.end()
        if error is None:
            assert (stopped.returncode, code) == (0, 0), f"{stopped.stdout}\n{self.last_words}"

    def gateway(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run another command of the installed program to its end."""
        return self._prefix.attempt(self._pc.program, *arguments)

    @property
    def last_words(self) -> str:
        """The end of what it wrote."""
        return self._program.said()[-_TAIL:]
