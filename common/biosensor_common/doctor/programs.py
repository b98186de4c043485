"""Asks programs of the system what only they know."""

from __future__ import annotations

import subprocess

from biosensor_common.system_programs import full_path

TIME_LIMIT_S = 5.0


def output_of(*command: str) -> str | None:
    """Return what a program says, whatever its exit code; None if it is not there or hangs."""
    ended = _ended(*command)
    return None if ended is None else ended.stdout


def succeeds(*command: str) -> bool | None:
    """Return whether a program ends with exit code 0; None if it is not there or hangs."""
    ended = _ended(*command)
    return None if ended is None else ended.returncode == 0


def _ended(*command: str) -> subprocess.CompletedProcess[str] | None:
    path = full_path(command[0])
    if path is None:
        return None
    try:
        return subprocess.run(
            [path, *command[1:]],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            errors="replace",
            timeout=TIME_LIMIT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
