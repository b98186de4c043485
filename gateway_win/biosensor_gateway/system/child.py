"""Starts this program as another process, which can notice that this one has ended."""

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
    """Return the command line that runs this program with arguments."""
    if getattr(sys, "frozen", False):
        # An installation has two programs in its folder; this is the one with a console.
        return [str(Path(sys.executable).with_name(_PROGRAM)), *arguments]
    return [sys.executable, "-P", "-m", "biosensor_gateway.cli", *arguments]


def start_beside(
    arguments: Sequence[str],
    environment: Mapping[str, str] | None = None,
    *,
    output: int | IO[bytes] = subprocess.DEVNULL,
    cwd: Path | None = None,
) -> None:
    """Start this program with arguments, without a terminal; it outlives this process.

    Parameters
    ----------
    environment
        Variables in addition to those of this process.

    Raises
    ------
    OSError
        If the system cannot start it.
    """
    process = child.start(
        own_command(arguments),
        stdout=output,
        stderr=output,
        env=os.environ | (environment or {}),
        cwd=cwd,
    )
    # On POSIX a process that has ended stays as a zombie until its parent has waited for it.
    threading.Thread(target=process.wait, name=f"{arguments[0]} beside", daemon=True).start()


def start_for(arguments: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start this program with arguments and with pipes, for as long as this process runs.

    The started process calls `first_line` and `when_input_ends`. Raises ``OSError`` if the system
    cannot start it.
    """
    return child.start(own_command(arguments), stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def first_line() -> bytes:
    """Return the first line from the parent process; empty if that has ended."""
    return _input().readline()


def when_input_ends(call: Callable[[], object]) -> None:
    """Call a function, in a thread, when the parent process closes this one's input or ends."""

    def read() -> None:
        _input().read()
        call()

    threading.Thread(target=read, name="input", daemon=True).start()


def _input() -> FileIO:
    # Unbuffered, because the interpreter cannot exit while a thread holds a buffer's lock.
    return FileIO(_STDIN, closefd=False)


def lives(process: object) -> bool:
    """Whether a process with this id runs; True if that cannot be known."""
    import psutil

    try:
        return psutil.Process(int(str(process))).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
    except (psutil.Error, ValueError, OverflowError):
        return True
