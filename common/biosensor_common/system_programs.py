"""Finds programs of the system by their full path, never in the current folder, and asks them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

TIME_LIMIT_S = 5.0
"""For what is asked of a program."""

if sys.platform == "win32":
    import ctypes

    _LONGEST_PATH = 32768
    _SUFFIX = ".exe"

    def windows_folder(*, system: bool) -> Path:
        r"""Return where Windows is, or its programs (``System32``), whatever variables say.

        Raises
        ------
        OSError
            Windows does not tell.
        """
        text = ctypes.create_unicode_buffer(_LONGEST_PATH)
        kernel = ctypes.windll.kernel32
        ask = kernel.GetSystemDirectoryW if system else kernel.GetSystemWindowsDirectoryW
        if not ask(text, _LONGEST_PATH):
            raise ctypes.WinError()
        return Path(text.value)

    def _folders() -> Iterator[Path]:
        yield windows_folder(system=True)

else:
    _SUFFIX = ""

    def _folders() -> Iterator[Path]:
        # An entry that is empty, or relative, is the current folder, or lies in it.
        entries = os.environ.get("PATH", os.defpath).split(os.pathsep)
        yield from (folder for folder in map(Path, entries) if folder.is_absolute())


def full_path(name: str) -> str | None:
    r"""Return where a program of the system is; None if it is not there.

    Windows has its own in ``System32``, and nowhere else is looked. Elsewhere they are in
    the folders of ``PATH``, of which those are left out that depend on the current folder:
    a study's folder may hold a program that somebody else put there (CWE-427).
    """
    for folder in _folders():
        program = folder / f"{name}{_SUFFIX}"
        # Unlike Path.is_file, this is no error in a folder that this user may not look into.
        if os.path.isfile(program) and os.access(program, os.X_OK):  # noqa: PTH113
            return str(program)
    return None


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
