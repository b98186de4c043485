"""Keeps a console window open that would close with this program, and switches QuickEdit off.

Every command imports this at its end, so it imports nothing heavy.
Source: Microsoft's documentation of ``GetConsoleProcessList``.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import sys
from collections.abc import Generator


def is_own_window() -> bool:
    """Whether the console window closes with this process, as after a double click.

    Always False on other systems than Windows.
    """
    if sys.platform != "win32":
        return False
    import ctypes

    processes = (ctypes.c_uint32 * 2)()
    # The function returns the number of all processes, even if the array is too small for them.
    return ctypes.windll.kernel32.GetConsoleProcessList(processes, 2) == 1


def hold_open() -> None:
    """Let a window that would close with this process wait for the Enter key first."""
    if is_own_window() and has_a_reader():
        # At exit, because a traceback is printed after this call.
        atexit.register(_await_enter)


def has_a_reader() -> bool:
    """Whether a person can read the output and press a key."""
    # A windowed program has neither stream, although their types do not say so.
    return all(each is not None and each.isatty() for each in (sys.stdin, sys.stdout))


def _await_enter() -> None:
    # SystemExit, because Ctrl-C raises that until the agent runs.
    with contextlib.suppress(EOFError, KeyboardInterrupt, SystemExit):
        input("Press Enter to close this window. ")


ENABLE_QUICK_EDIT_MODE, ENABLE_EXTENDED_FLAGS = 0x0040, 0x0080


def without_quick_edit(mode: int) -> int:
    """Return a console's mode with QuickEdit off; the other flags stay as they are."""
    return mode & ~ENABLE_QUICK_EDIT_MODE | ENABLE_EXTENDED_FLAGS


@contextlib.contextmanager
def quick_edit_off() -> Generator[None]:
    """Switch QuickEdit off while the context lasts; does nothing without a Windows console.

    The mode is restored, because the console may be used by other programs afterwards. A program
    that is killed leaves QuickEdit off.
    """
    with contextlib.ExitStack() as stack:
        if sys.platform == "win32":
            # Not stdin, which may be redirected while the console can still be clicked into.
            with contextlib.suppress(OSError):
                console = os.open("CONIN$", os.O_RDWR)
                stack.callback(os.close, console)
                before = _mode(console)
                _set_mode(console, without_quick_edit(before))
                stack.callback(_put_back, console, before)
        yield


if sys.platform == "win32":
    import ctypes
    import msvcrt
    from ctypes import wintypes

    _kernel = ctypes.WinDLL("kernel32", use_last_error=True)
    _kernel.GetConsoleMode.argtypes = [wintypes.HANDLE, ctypes.POINTER(wintypes.DWORD)]
    _kernel.GetConsoleMode.restype = wintypes.BOOL
    _kernel.SetConsoleMode.argtypes = [wintypes.HANDLE, wintypes.DWORD]
    _kernel.SetConsoleMode.restype = wintypes.BOOL

    def _mode(console: int) -> int:
        mode = wintypes.DWORD()
        if not _kernel.GetConsoleMode(msvcrt.get_osfhandle(console), ctypes.byref(mode)):
            raise ctypes.WinError(ctypes.get_last_error())
        return mode.value

    def _set_mode(console: int, mode: int) -> None:
        if not _kernel.SetConsoleMode(msvcrt.get_osfhandle(console), mode):
            raise ctypes.WinError(ctypes.get_last_error())

    def _put_back(console: int, mode: int) -> None:
        # Windows applies the QuickEdit flag only together with EXTENDED_FLAGS.
        with contextlib.suppress(OSError):
            _set_mode(console, mode | ENABLE_EXTENDED_FLAGS)
