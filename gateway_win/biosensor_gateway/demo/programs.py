"""Runs agent, page, node and table as processes of their own, as they are in a lab.

What they say goes to a log file each, and is shown if one of them ends before its time.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Collection, Generator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from biosensor_common.child import wait_or_kill
from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.settings.places import STATE_VARIABLE

STOP_TIMEOUT_S = 10.0


def python_program(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module of this installation."""
    return [sys.executable, "-P", "-m", module, *arguments]


def environment(folder: Path) -> Mapping[str, str]:
    """Return the variables of programs that leave nothing behind but in this folder.

    A try-out stays on this machine unless the user says otherwise, and beside the user's own
    agent, whose state folder is taken. It needs no home folder.
    """
    local = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(folder / "ros")}
    return {**local, **os.environ, STATE_VARIABLE: str(state_of(folder))}


def state_of(folder: Path) -> Path:
    """Return the state folder of the programs that have this `environment`."""
    return folder / "state"


class Programs:
    """The programs of a try-out, by name, with their logs in a folder.

    Parameters
    ----------
    folder
        Is there; see `environment`.

    Attributes
    ----------
    may_end
        Names of those that a person may end.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.may_end: Collection[str] = ()
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    @contextmanager
    def started(self, name: str, command: Sequence[str]) -> Generator[None]:
        """Run a program while the context lasts."""
        with self._log(name).open("wb") as log:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment(self._folder),
            )
        self._running[name] = process
        try:
            yield
        finally:
            del self._running[name]
            stop(process)

    def has_ended(self, name: str) -> bool:
        """Whether a person has ended it."""
        return name in self.may_end and self._running[name].poll() == 0

    def require_running(self) -> None:
        """See that none of them has ended but those that a person has ended.

        Raises
        ------
        TransportError
            ``ABSENT``, with what the one that ended has said.
        """
        for name, process in self._running.items():
            if process.poll() is not None and not self.has_ended(name):
                log = self._log(name).read_text(encoding="utf-8", errors="replace")
                message = f"the {name} ended unexpectedly; it had said:\n{log.rstrip()}"
                raise TransportError(TransportReason.ABSENT, message)

    def _log(self, name: str) -> Path:
        return self._folder / f"{name}.log"


def stop(process: subprocess.Popen[bytes]) -> None:
    """End a process, as Ctrl-C does where that can be sent, and wait for it."""
    if process.poll() is None:
        if sys.platform == "win32":
            process.terminate()
        else:
            process.send_signal(signal.SIGINT)
        wait_or_kill(process, STOP_TIMEOUT_S)
