"""Starts this program again for another task, and tells that one when this one has ended."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from io import FileIO
from pathlib import Path
from typing import IO

from biosensor_common import child

_PROGRAM = "biosensor-gateway.exe"
_STDIN = 0


def own_command(arguments: Sequence[str]) -> list[str]:
    """Return the command line that runs this program with arguments.

    An installed one has two programs in its folder; this is the one with a console.
    """
    if getattr(sys, "frozen", False):
        return [str(Path(sys.executable).with_name(_PROGRAM)), *arguments]
    return [sys.executable, "-P", "-m", "biosensor_gateway.cli", *arguments]


def start_beside(
    arguments: Sequence[str],
    environment: Mapping[str, str] | None = None,
    *,
    output: int | IO[bytes] = subprocess.DEVNULL,
    cwd: Path | None = None,
) -> None:
    """Run this program with arguments, without a terminal; it outlives this one.

    Parameters
    ----------
    environment
        Variables that it has beside those of this one.

    Raises
    ------
    OSError
        The system cannot start it.
    """
    # Nothing that this one has open may be held open by it.
    process = child.start(
        own_command(arguments),
        stdout=output,
        stderr=output,
        env=os.environ | (environment or {}),
        cwd=cwd,
    )
    # On POSIX a child that ended stays until somebody has waited for it.
    threading.Thread(target=process.wait, name=f"{arguments[0]} beside", daemon=True).start()


def start_for(arguments: Sequence[str]) -> subprocess.Popen[bytes]:
    """Run this program with arguments and pipes to and from it, for as long as this one runs.

    The other side has `first_line` and `when_input_ends`. Raises ``OSError`` if the system cannot
    start it.
    """
    return child.start(own_command(arguments), stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def first_line() -> bytes:
    """Return the first line that came from whoever started this process; empty if it has gone."""
    return _input().readline()


def when_input_ends(call: Callable[[], object]) -> None:
    """Call a function, in a thread, when whoever started this process closes its input or dies."""

    def read() -> None:
        _input().read()
        call()

    threading.Thread(target=read, name="input", daemon=True).start()


def _input() -> FileIO:
    # Unbuffered: a thread that reads from a buffer cannot be left behind at the end.
    return FileIO(_STDIN, closefd=False)


def lives(process: object) -> bool:
    """Whether a process of that number lives; if that cannot be known, it does."""
    import psutil

    try:
        return psutil.Process(int(str(process))).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
    except (psutil.Error, ValueError, OverflowError):
        return True
