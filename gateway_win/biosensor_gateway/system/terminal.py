"""Tells what a terminal can do, and has a Windows console understand cursor movements.

Source: Microsoft's "Console Virtual Terminal Sequences" and ``SetConsoleMode``.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Generator

from biosensor_gateway.system.panel import Size

ENABLE_VIRTUAL_TERMINAL_PROCESSING = 0x0004
_NO_CURSOR = frozenset({"dumb", "unknown"})


@contextlib.contextmanager
def cursor_moves(descriptor: int) -> Generator[bool]:
    """Say whether a program may move the cursor of the terminal behind a descriptor.

    A Windows console is made to heed such commands while the context lasts; before Windows 10
    none does.
    """
    with contextlib.ExitStack() as stack:
        yield os.isatty(descriptor) and _prepared(descriptor, stack)


def shows_colours() -> bool:
    """Whether a terminal may be given colours (https://no-color.org).

    A Windows console shows them only while `cursor_moves` lasts.
    """
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM") not in _NO_CURSOR


def terminal_size(descriptor: int) -> Size | None:
    """Return the size of a terminal; None while it is not this process's to draw on."""
    if sys.platform == "win32":
        return _window(descriptor)
    try:
        columns, lines = os.get_terminal_size(descriptor)
    except OSError:
        return None
    # Serial consoles do not know their size.
    return Size(columns or 80, lines or 24) if _is_in_front(descriptor) else None


def _is_in_front(descriptor: int) -> bool:
    if sys.platform == "win32":
        return True
    try:
        return os.tcgetpgrp(descriptor) == os.getpgrp()
    except OSError:
        # It is not the terminal that controls this process: no shell has put it behind.
        return True


if sys.platform == "win32":
    import ctypes
    import msvcrt
    from ctypes import wintypes

    class _Coordinates(ctypes.Structure):
        """``COORD``."""

        _fields_ = (("x", wintypes.SHORT), ("y", wintypes.SHORT))

    class _BufferInfo(ctypes.Structure):
        """``CONSOLE_SCREEN_BUFFER_INFO``."""

        _fields_ = (
            ("size", _Coordinates),
            ("cursor", _Coordinates),
            ("attributes", wintypes.WORD),
            ("window", wintypes.SMALL_RECT),
            ("largest", _Coordinates),
        )

    _kernel = ctypes.WinDLL("kernel32", use_last_error=True)
    _kernel.GetConsoleMode.argtypes = [wintypes.HANDLE, ctypes.POINTER(wintypes.DWORD)]
    _kernel.GetConsoleMode.restype = wintypes.BOOL
    _kernel.SetConsoleMode.argtypes = [wintypes.HANDLE, wintypes.DWORD]
    _kernel.SetConsoleMode.restype = wintypes.BOOL
    _kernel.GetConsoleScreenBufferInfo.argtypes = [wintypes.HANDLE, ctypes.POINTER(_BufferInfo)]
    _kernel.GetConsoleScreenBufferInfo.restype = wintypes.BOOL

    def _prepared(descriptor: int, stack: contextlib.ExitStack) -> bool:
        console = msvcrt.get_osfhandle(descriptor)
        before = wintypes.DWORD()
        if not _kernel.GetConsoleMode(console, ctypes.byref(before)):
            return False
        if not _kernel.SetConsoleMode(console, before.value | ENABLE_VIRTUAL_TERMINAL_PROCESSING):
            return False
        stack.callback(_kernel.SetConsoleMode, console, before.value)
        return True

    def _window(descriptor: int) -> Size | None:
        info = _BufferInfo()
        console = msvcrt.get_osfhandle(descriptor)
        if not _kernel.GetConsoleScreenBufferInfo(console, ctypes.byref(info)):
            return None
        seen = info.window
        return Size(seen.Right - seen.Left + 1, seen.Bottom - seen.Top + 1)
else:

    def _prepared(descriptor: int, stack: contextlib.ExitStack) -> bool:
        del descriptor, stack
        return os.environ.get("TERM", "dumb") not in _NO_CURSOR
