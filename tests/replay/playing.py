"""The command as a process of its own."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

PATIENCE_S = 60.0


class Playing:
    """A replay that runs; `said` is complete once it has ended."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.said = ""

    def ended(self) -> int:
        """Wait for the end; return the exit code."""
        rest, _ = self._process.communicate(timeout=PATIENCE_S)
        self.said += rest
        return self._process.returncode

    def interrupt(self) -> int:
        """Press Ctrl-C; return the exit code."""
        self._process.send_signal(signal.SIGINT)
        return self.ended()

    def begun(self) -> str:
        """Wait until the streams are on the network; return the sentence that says so."""
        assert self._process.stdout is not None
        self.said += self._process.stdout.readline()
        return self.said


@contextmanager
def playing(file: Path, *options: str) -> Generator[Playing]:
    command = [sys.executable, "-m", "biosensor_gateway.cli", "replay", str(file), *options]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8"
    )
    try:
        yield Playing(process)
    finally:
        process.kill()
        process.communicate()
