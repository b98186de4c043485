"""Notices on Windows when a console or the session ends."""

from __future__ import annotations

import ctypes
import sys
import threading
import time
from collections.abc import Callable

import structlog

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
        _log.debug("not notified of the session's end before others", error=ctypes.get_last_error())

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
