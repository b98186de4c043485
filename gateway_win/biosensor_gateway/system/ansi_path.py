"""Finds file names for Windows programs that can only open names in the ANSI code page."""

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
    """Return the short (8.3) name of an existing path; empty if the disk has none."""
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
    """Return a name of an existing folder that any program can open; None if it has none.

    Parameters
    ----------
    is_windows, fits, short
        Properties of the system; tests replace them.
    """
    if not is_windows or fits(str(folder)):
        return folder
    named = short(str(folder))
    return Path(named) if named and fits(named) else None
