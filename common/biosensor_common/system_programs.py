"""Finds system programs by their full path, never in the current folder, and runs them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

TIME_LIMIT_S = 5.0
"""Time limit of a program."""

if sys.platform == "win32":
    import ctypes

    _LONGEST_PATH = 32768
    _SUFFIX = ".exe"

    def windows_folder(*, system: bool) -> Path:
        r"""Return the folder of Windows or of its programs (``System32``), ignoring variables.

        Raises
        ------
        OSError
            If Windows does not return it.
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
        # An empty or relative entry means the current folder or one below it.
        entries = os.environ.get("PATH", os.defpath).split(os.pathsep)
        yield from (folder for folder in map(Path, entries) if folder.is_absolute())


def full_path(name: str) -> str | None:
    r"""Return the full path of a system program; None if it does not exist.

    On Windows only ``System32`` is searched. Elsewhere the folders of ``PATH`` are searched, but
    not those that depend on the current folder: a study's folder may contain a program that
    somebody else put there (CWE-427).
    """
    for folder in _folders():
        program = folder / f"{name}{_SUFFIX}"
        # Unlike Path.is_file, this does not raise for a folder that the user may not read.
        if os.path.isfile(program) and os.access(program, os.X_OK):  # noqa: PTH113
            return str(program)
    return None


def output_of(*command: str) -> str | None:
    """Return a program's output with any exit code; None if it does not exist or hangs."""
    ended = _ended(*command)
    return None if ended is None else ended.stdout


def succeeds(*command: str) -> bool | None:
    """Return whether a program's exit code is 0; None if it does not exist or hangs."""
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
