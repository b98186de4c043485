"""Keeps a console window open that would close with this program, before its text was read.

Source: Microsoft's documentation of ``GetConsoleProcessList``.
"""

from __future__ import annotations

import atexit
import contextlib
import sys


def is_own_window() -> bool:
    """Whether a console window closes when this process ends: it was started by a double click.

    Never on other systems than Windows.
    """
    if sys.platform != "win32":
        return False
    import ctypes

    processes = (ctypes.c_uint32 * 2)()
    # It counts all processes on the console, also those that do not fit into the array.
    return ctypes.windll.kernel32.GetConsoleProcessList(processes, 2) == 1


def hold_open() -> None:
    """Let a window that closes with this process wait for the Enter key first."""
    if is_own_window() and has_a_reader():
        # A traceback is printed after this.
        atexit.register(_await_enter)


def has_a_reader() -> bool:
    """Whether somebody sees what is written, and can press a key."""
    # A program without a console has neither, whatever their types say.
    return all(each is not None and each.isatty() for each in (sys.stdin, sys.stdout))


def _await_enter() -> None:
    # Ctrl-C ends a program that has not begun by SystemExit.
    with contextlib.suppress(EOFError, KeyboardInterrupt, SystemExit):
        input("Press Enter to close this window. ")
