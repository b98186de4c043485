"""Programs on a computer of the network, and how a test steers and ends them."""

from __future__ import annotations

import json
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from tests.rigs.hosts.lan import Host

STOP_TIMEOUT_S = 30.0
_LOG_TAIL = 4000


class ProgramError(Exception):
    """A program on a computer did not do what it was told; shows what it said last."""


class Program:
    """A module that runs on a computer until SIGINT; a context manager.

    Parameters
    ----------
    folder
        Where its log goes.

    Raises
    ------
    ProgramError
        On leaving, if it has not ended with exit code 0.
    """

    _steered = False

    def __init__(
        self, host: Host, environment: Mapping[str, str], folder: Path, module: str, *options: str
    ) -> None:
        self._name = f"{module} on {host.name}"
        self._is_killed = False
        self._log = folder / f"{host.name}-{module}.log"
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                host.command(sys.executable, "-m", module, *options),
                env=dict(environment),
                stdin=subprocess.PIPE if self._steered else subprocess.DEVNULL,
                stdout=subprocess.PIPE if self._steered else log,
                stderr=log,
                text=True,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._ask_to_end()
            code = self._process.wait(STOP_TIMEOUT_S)
        finally:
            self._process.kill()
            self._process.wait()
            self._close()
        if code and error is None and not self._is_killed:
            raise ProgramError(f"{self._name} ended with exit code {code}\n{self.last_words}")

    @property
    def pid(self) -> int:
        """Of the program itself: what leads to its computer has become it."""
        return self._process.pid

    @property
    def log(self) -> str:
        """What it wrote so far."""
        return self._log.read_text(errors="replace")

    @property
    def last_words(self) -> str:
        """The end of what it wrote."""
        return self.log[-_LOG_TAIL:]

    def kill(self) -> None:
        """End it by SIGKILL, and see it dead."""
        self._is_killed = True
        self._process.kill()
        self._process.wait()

    def _ask_to_end(self) -> None:
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)

    def _close(self) -> None:
        """Close what is left of it."""


class SteeredProgram(Program):
    """A program that answers commands; see :mod:`tests.rigs.hosts.programs`."""

    _steered = True

    def ask(self, do: str, **details: object) -> Any:
        """Give it a command; return the answer.

        Raises
        ------
        ProgramError
            If it has ended, or could not obey.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps({"do": do, **details}) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise ProgramError(f"{self._name} has ended\n{self.last_words}")
        said = json.loads(line)
        if "error" in said:
            raise ProgramError(f"{self._name}: {said['error']}")
        return said["answer"]

    def _ask_to_end(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()

    def _close(self) -> None:
        assert self._process.stdout is not None
        self._process.stdout.close()


Obey = Callable[[Mapping[str, Any]], Any]
"""Carries out one command; what it returns is the answer."""


class Dialogue:
    """The steered side; commands are carried out in the thread that calls `answer`."""

    def __init__(self) -> None:
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._ended = threading.Event()
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def ended(self) -> bool:
        """Whether nobody will command any more."""
        return self._ended.is_set()

    def answer(self, obey: Obey) -> None:
        """Carry out the commands that have come; an error is an answer, too."""
        while not self._lines.empty():
            try:
                answer = {"answer": obey(json.loads(self._lines.get()))}
            except Exception as error:  # noqa: BLE001 - whoever gave the command gets its error
                answer = {"error": f"{type(error).__name__}: {error}"}
            print(json.dumps(answer), flush=True)

    def _read(self) -> None:
        for line in sys.stdin:
            self._lines.put(line)
        self._ended.set()
