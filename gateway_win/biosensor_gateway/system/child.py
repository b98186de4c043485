"""Starts this program again, for another task."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

_PROGRAM = "biosensor-gateway.exe"

if sys.platform == "win32":
    NO_WINDOW = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
else:
    NO_WINDOW = 0
"""Flags of a process that has neither a window nor this one's Ctrl-C."""


def own_command(arguments: Sequence[str]) -> list[str]:
    """Return the command line that runs this program with arguments.

    An installed one has two programs in its folder; this is the one with a console.
    """
    if getattr(sys, "frozen", False):
        return [str(Path(sys.executable).with_name(_PROGRAM)), *arguments]
    return [sys.executable, "-P", "-m", "biosensor_gateway.cli", *arguments]


def start_beside(arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
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
    subprocess.Popen(
        own_command(arguments),
        env=os.environ | (environment or {}),
        # Nothing that this one has open may be held open by it.
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        creationflags=NO_WINDOW,
        # Ctrl-C at this one's terminal is meant for this one.
        start_new_session=True,
    )


def start_for(arguments: Sequence[str]) -> subprocess.Popen[bytes]:
    """Run this program with arguments and pipes to and from it, for as long as this one runs.

    What it runs ends when its input ends, which the system sees to if this one is killed.

    Raises
    ------
    OSError
        The system cannot start it.
    """
    return subprocess.Popen(
        own_command(arguments),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        creationflags=NO_WINDOW,
        # Ctrl-C at this one's terminal is meant for this one, which ends the other.
        start_new_session=True,
    )


def close_input(process: subprocess.Popen[bytes]) -> None:
    """Ask what :func:`start_for` has started to end; nothing if it has ended."""
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()
