"""Child processes of the tests."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any


class Program:
    """A child process that writes to a file, so that no pipe can block it.

    Parameters
    ----------
    log
        File of its output and errors.
    options
        As for :class:`subprocess.Popen`.
    """

    def __init__(self, command: Sequence[str], log: Path, **options: Any) -> None:
        self._log = log
        with log.open("wb") as output:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                **options,
            )

    @property
    def output(self) -> str:
        """All that it has written."""
        return self._log.read_text(errors="replace")

    @property
    def records(self) -> list[dict[str, Any]]:
        """JSON objects that it has written, each on a line of its own."""
        complete = self.output.rpartition("\n")[0].splitlines()
        return [json.loads(line) for line in complete if line.startswith("{")]

    def end(self) -> None:
        """Kill it, if it still runs."""
        self.process.kill()
        self.process.wait()
