"""The Windows session: keeps a console open, and notices when console or session end."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import sys
import threading
import time
from collections.abc import Callable, Generator

import structlog


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


CTRL_C_EVENT, CTRL_BREAK_EVENT = 0, 1
WM_QUERYENDSESSION, WM_ENDSESSION = 0x0011, 0x0016
WINDOW_CLASS = "BiosensorGatewaySession"
_NOTIFIED_FIRST = 0x3FF
"""The highest shutdown level of programs, notified first; the default is 0x280."""
# Windows ends a program 5 s after the notification (HungAppTimeout).
GRACE_S = 4.5
_log = structlog.get_logger("biosensor_gateway.shutdown")


def watch(stop: Callable[[], None], *, before_others: bool = False) -> None:
    """Call ``stop`` at Ctrl-Break, the console's close and the session's end.

    To be called once in a process. ``stop`` is called in other threads than the main one.
    Except for Ctrl-Break, Windows ends the process as soon as the handler returns, so the
    handler waits for `GRACE_S`, in which the process has time to exit by itself.

    Parameters
    ----------
    before_others
        Whether this process is to be notified of the session's end before other programs.

    Raises
    ------
    OSError
        If Windows refuses the console control handler.
    """
    assert sys.platform == "win32"
    if before_others and not _kernel32().SetProcessShutdownParameters(_NOTIFIED_FIRST, 0):
        _log.debug("not told of the session's end before others", error=ctypes.get_last_error())

    def stop_and_wait_for_exit() -> None:
        stop()
        time.sleep(GRACE_S)

    _watch_console(stop, stop_and_wait_for_exit)
    threading.Thread(
        target=_watch_session, args=[stop_and_wait_for_exit], name="session end", daemon=True
    ).start()


if sys.platform == "win32":
    from ctypes import wintypes

    # ctypes.wintypes has no LRESULT; it is as wide as LPARAM.
    _HandlerRoutine = ctypes.WINFUNCTYPE(wintypes.BOOL, wintypes.DWORD)
    _PROCEDURE_ARGUMENTS = (wintypes.HWND, wintypes.UINT, wintypes.WPARAM, wintypes.LPARAM)
    _WindowProcedure = ctypes.WINFUNCTYPE(wintypes.LPARAM, *_PROCEDURE_ARGUMENTS)

    class _WindowClass(ctypes.Structure):
        """``WNDCLASSW``."""

        _fields_ = (
            ("style", wintypes.UINT),
            ("procedure", _WindowProcedure),
            ("class_extra", ctypes.c_int),
            ("window_extra", ctypes.c_int),
            ("instance", wintypes.HINSTANCE),
            ("icon", wintypes.HICON),
            ("cursor", wintypes.HANDLE),
            ("background", wintypes.HBRUSH),
            ("menu_name", wintypes.LPCWSTR),
            ("class_name", wintypes.LPCWSTR),
        )

    def _watch_console(
        stop: Callable[[], None], stop_and_wait_for_exit: Callable[[], None]
    ) -> None:
        @_HandlerRoutine
        def handle(event: int) -> bool:
            if event == CTRL_C_EVENT:
                # Left to Python's handler, which raises SIGINT.
                return False
            if event == CTRL_BREAK_EVENT:
                stop()
            else:
                stop_and_wait_for_exit()
            return True

        _keep_for_ever(handle)
        if not _kernel32().SetConsoleCtrlHandler(handle, True):
            raise ctypes.WinError(ctypes.get_last_error())

    def _watch_session(stop_and_wait_for_exit: Callable[[], None]) -> None:
        """Create a hidden window and answer its messages until the process exits."""
        user32 = _user32()

        @_WindowProcedure
        def answer(window: int, message: int, wparam: int, lparam: int) -> int:
            if message == WM_QUERYENDSESSION:
                return True
            if message == WM_ENDSESSION:
                # wparam is 0 when another program has objected.
                if wparam:
                    stop_and_wait_for_exit()
                return 0
            return user32.DefWindowProcW(window, message, wparam, lparam)

        _keep_for_ever(answer)
        try:
            _make_window(user32, answer)
        except OSError as error:
            _log.debug("no window, so logoff and shutdown are not noticed", error=str(error))
            return
        message = wintypes.MSG()
        while user32.GetMessageW(ctypes.byref(message), None, 0, 0) > 0:
            user32.DispatchMessageW(ctypes.byref(message))

    def _make_window(user32: ctypes.WinDLL, procedure: object) -> None:
        """Create a top-level window that is never shown; only such windows get these messages."""
        window_class = _WindowClass(procedure=procedure, class_name=WINDOW_CLASS)
        if not user32.RegisterClassW(ctypes.byref(window_class)):
            raise ctypes.WinError(ctypes.get_last_error())
        name = "Biosensor Gateway"
        position_and_size = (0, 0, 0, 0)
        if not user32.CreateWindowExW(
            0, WINDOW_CLASS, name, 0, *position_and_size, None, None, None, None
        ):
            raise ctypes.WinError(ctypes.get_last_error())

    def _kernel32() -> ctypes.WinDLL:
        kernel32 = ctypes.WinDLL("kernel32", use_last_error=True)
        kernel32.SetConsoleCtrlHandler.argtypes = [_HandlerRoutine, wintypes.BOOL]
        kernel32.SetConsoleCtrlHandler.restype = wintypes.BOOL
        kernel32.SetProcessShutdownParameters.argtypes = [wintypes.DWORD, wintypes.DWORD]
        kernel32.SetProcessShutdownParameters.restype = wintypes.BOOL
        return kernel32

    def _user32() -> ctypes.WinDLL:
        user32 = ctypes.WinDLL("user32", use_last_error=True)
        user32.RegisterClassW.argtypes = [ctypes.POINTER(_WindowClass)]
        user32.RegisterClassW.restype = wintypes.ATOM
        user32.CreateWindowExW.argtypes = [
            *(wintypes.DWORD, wintypes.LPCWSTR, wintypes.LPCWSTR, wintypes.DWORD),
            *(ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_int),
            *(wintypes.HWND, wintypes.HMENU, wintypes.HINSTANCE, wintypes.LPVOID),
        ]
        user32.CreateWindowExW.restype = wintypes.HWND
        user32.DefWindowProcW.argtypes = _PROCEDURE_ARGUMENTS
        user32.DefWindowProcW.restype = wintypes.LPARAM
        user32.GetMessageW.argtypes = [wintypes.LPMSG, wintypes.HWND, wintypes.UINT, wintypes.UINT]
        user32.GetMessageW.restype = wintypes.BOOL
        user32.DispatchMessageW.argtypes = [wintypes.LPMSG]
        user32.DispatchMessageW.restype = wintypes.LPARAM
        return user32

    def _keep_for_ever(callback: object) -> None:
        """Keep a callback alive for Windows, even while the interpreter shuts down."""
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(callback))
