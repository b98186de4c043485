"""Holds off sleep on macOS and Linux by a program that does so for as long as it runs."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from biosensor_common import child


class ProgramInhibitor:
    """A program that holds off sleep for as long as it runs.

    Parameters
    ----------
    command
        The program and its arguments. It must end when its standard input or this
        process does.
    echoes
        Whether it gives back what it reads as soon as it holds off sleep. Of a
        program that does not, it is believed as long as it runs.
    """

    def __init__(self, command: Sequence[str], *, echoes: bool) -> None:
        self._command = command
        self._echoes = echoes
        self._answered = False
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def way(self) -> str:
        """Name of the program."""
        return Path(self._command[0]).name

    def begin(self) -> None:
        """Start the program; raises ``OSError`` if it cannot be."""
        self._answered = not self._echoes
        pipe = subprocess.PIPE
        self._process = process = child.start(
            self._command, stdin=pipe, stdout=pipe, stderr=pipe, bufsize=0
        )
        assert process.stdout is not None
        assert process.stderr is not None
        if sys.platform != "win32":  # which has no such program
            os.set_blocking(process.stdout.fileno(), False)
            os.set_blocking(process.stderr.fileno(), False)
        # If it has ended already, held() knows why.
        child.send(process, b"\n")

    def held(self) -> bool:
        """Whether the program holds off sleep; raises ``OSError`` if it has ended."""
        process = self._process
        if process is None:
            return False
        assert process.stdout is not None
        assert process.stderr is not None
        if process.poll() is not None:
            said = (process.stderr.read() or b"").decode(errors="replace").split("\n")
            last = next((line for line in reversed(said) if line.strip()), "it ended by itself")
            raise OSError(last.strip())
        if not self._answered:
            self._answered = bool(process.stdout.read(1))
        return self._answered

    def end(self) -> None:
        """End the program."""
        if self._process is not None:
            with self._process as process:
                self._process = None
                process.kill()
