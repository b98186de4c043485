"""Names files so that programs can open them that know the letters of one code page only."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from pathlib import Path

_LONGEST = 32768


def _fits(text: str) -> bool:
    try:
        text.encode("mbcs")
    except UnicodeEncodeError:
        return False
    return True


def _short(text: str) -> str:
    """Return the short name (8.3) of what exists; empty where the disk keeps none."""
    if sys.platform != "win32":
        return ""
    buffer = ctypes.create_unicode_buffer(_LONGEST)
    length = ctypes.windll.kernel32.GetShortPathNameW(text, buffer, _LONGEST)
    return buffer.value if 0 < length < _LONGEST else ""


def ansi_folder(
    folder: Path,
    *,
    is_windows: bool = sys.platform == "win32",
    fits: Callable[[str], bool] = _fits,
    short: Callable[[str], str] = _short,
) -> Path | None:
    """Return a name of a folder that any program can open; None if it has no such name.

    Parameters
    ----------
    folder
        Exists.
    is_windows, fits, short
        What is known of the system.
    """
    if not is_windows or fits(str(folder)):
        return folder
    named = short(str(folder))
    return Path(named) if named and fits(named) else None
