"""Starts another process, ends it within a limit, and says how it ended and when to restart it."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from os import PathLike
from typing import IO, Any

LONGEST_DELAY_S = 30.0
STABLE_AFTER_S = 60.0
"""A process that lived so long did not die of its start."""

if sys.platform == "win32":
    NO_WINDOW = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
else:
    NO_WINDOW = 0
"""Flags of a process that has neither a window nor this one's Ctrl-C."""

_CRASHES = 0xC0000000
"""From here on Windows' exit codes are errors that end programs."""


def start(
    command: Sequence[str],
    *,
    stdin: int = subprocess.DEVNULL,
    stdout: int | IO[bytes] | None = subprocess.DEVNULL,
    stderr: int | IO[bytes] | None = subprocess.DEVNULL,
    env: Mapping[str, str] | None = None,
    cwd: PathLike[str] | None = None,
    pass_fds: Sequence[int] = (),
    bufsize: int = -1,
) -> subprocess.Popen[bytes]:
    """Start a process that has neither a window nor this one's terminal; raises ``OSError``.

    One whose input is a pipe, and that ends when its input ends, ends also if this one is killed.
    """
    return subprocess.Popen(
        command,
        stdin=stdin,
        stdout=stdout,
        stderr=stderr,
        env=env,
        cwd=cwd,
        pass_fds=pass_fds,
        bufsize=bufsize,
        creationflags=NO_WINDOW,
        # Ctrl-C at this one's terminal is meant for this one, which ends the other in good order.
        start_new_session=True,
    )


def send(process: subprocess.Popen[bytes], data: bytes) -> None:
    """Write to its input; nothing happens if it has ended, which its exit code says."""
    assert process.stdin is not None
    with suppress(OSError):
        process.stdin.write(data)
        process.stdin.flush()


def close_input(process: subprocess.Popen[bytes]) -> None:
    """Ask a process to end that ends with its input; nothing happens if it has ended."""
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()


def wait_or_kill(process: subprocess.Popen[Any], limit_s: float) -> bool:
    """Wait for a process that was asked to end; return whether it had to be killed."""
    try:
        process.wait(limit_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True
    return False


def ending_in_words(code: int) -> str:
    """Say how a process ended, by its exit code."""
    if code >= _CRASHES:
        # Windows' own names of what ends a program are of this form.
        return f"crash {code:#010X}".replace("0X", "0x")
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"killed by signal {-code}"


class Backoff:
    """Says how long to wait before a process that has died is started again.

    Parameters
    ----------
    first_s
        After the first death; then 1 s, 2 s, 4 s, up to `LONGEST_DELAY_S`.
    """

    def __init__(self, first_s: float = 0.0) -> None:
        self._first_s = first_s
        self._last_s: float | None = None

    def next_s(self, lived_s: float) -> float:
        """Return the delay after one that lived so long."""
        if self._last_s is None or lived_s >= STABLE_AFTER_S:
            self._last_s = self._first_s
        else:
            self._last_s = min(max(1.0, 2 * self._last_s), LONGEST_DELAY_S)
        return self._last_s
