"""Keeps a console window open that would close with this program, before its text was read.

Source: Microsoft's documentation of ``GetConsoleProcessList``.
"""

from __future__ import annotations

import atexit
import contextlib
import sys
from types import TracebackType


def is_own_window() -> bool:
    """Whether a console window closes when this process ends: it was started by a double click.

    Never on other systems than Windows.
    """
    if sys.platform != "win32":
        return False
    import ctypes  # noqa: PLC0415 - each command would wait for it

    processes = (ctypes.c_uint32 * 2)()
    # It counts all processes on the console, also those that do not fit into the array.
    return ctypes.windll.kernel32.GetConsoleProcessList(processes, 2) == 1


class HeldOpen:
    """Lets the window of a command that fails wait for the Enter key; a context manager."""

    def __enter__(self) -> None:
        pass

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        is_success = error is None or (isinstance(error, SystemExit) and not error.code)
        if not is_success and is_own_window() and _has_a_reader():
            # A traceback is printed after this.
            atexit.register(_await_enter)


def _has_a_reader() -> bool:
    # A program without a console has neither, whatever their types say.
    return all(each is not None and each.isatty() for each in (sys.stdin, sys.stdout))


def _await_enter() -> None:
    # Ctrl-C ends a program that has not begun by SystemExit.
    with contextlib.suppress(EOFError, KeyboardInterrupt, SystemExit):
        input("Press Enter to close this window. ")
