"""Holds off sleep by Windows' own functions.

Sources: Microsoft's documentation of ``PowerCreateRequest``, ``PowerSetRequest``,
``REASON_CONTEXT`` and ``SetThreadExecutionState``.
"""

from __future__ import annotations

import ctypes
import sys
from ctypes import wintypes

import structlog

_log = structlog.get_logger("biosensor_gateway.keep_awake")

if sys.platform == "win32":
    _ES_SYSTEM_REQUIRED = 0x00000001
    _ES_CONTINUOUS = 0x80000000
    _POWER_REQUEST_CONTEXT_VERSION = 0
    _POWER_REQUEST_CONTEXT_SIMPLE_STRING = 0x1
    _POWER_REQUEST_SYSTEM_REQUIRED = 1
    _INVALID_HANDLE = ctypes.c_void_p(-1).value

    class _DetailedReason(ctypes.Structure):
        _fields_ = (
            ("module", wintypes.HMODULE),
            ("reason_id", wintypes.ULONG),
            ("count", wintypes.ULONG),
            ("strings", ctypes.POINTER(wintypes.LPWSTR)),
        )

    class _Reason(ctypes.Union):
        _fields_ = (("detailed", _DetailedReason), ("text", wintypes.LPWSTR))

    class _ReasonContext(ctypes.Structure):
        _fields_ = (
            ("version", wintypes.ULONG),
            ("flags", wintypes.DWORD),
            ("reason", _Reason),
        )

    class WindowsInhibitor:
        """A power request, or the execution state of the calling thread where there is none.

        Parameters
        ----------
        reason
            Who asks and why, as ``powercfg /requests`` shows it.
        """

        def __init__(self, reason: str) -> None:
            self._reason = reason
            self._kernel = ctypes.WinDLL("kernel32", use_last_error=True)
            self._request: int | None = None

        @property
        def way(self) -> str:
            """Which of the two it is."""
            return "execution state" if self._request is None else "power request"

        def begin(self) -> None:
            """Ask Windows; raises ``OSError`` if it refuses both."""
            try:
                self._request = self._new_request()
            except (AttributeError, OSError) as error:
                # Wine has the functions and implements none.
                _log.debug("no power request", error=str(error))
                self._set_execution_state(_ES_CONTINUOUS | _ES_SYSTEM_REQUIRED)

        def held(self) -> bool:
            """Windows has answered at once."""
            return True

        def end(self) -> None:
            """Take back the request or the state."""
            if self._request is None:
                self._set_execution_state(_ES_CONTINUOUS)
            else:
                request, self._request = self._request, None
                # Closed, it requests nothing any more.
                self._close(request)

        def _new_request(self) -> int:
            create = self._kernel.PowerCreateRequest
            create.argtypes = [ctypes.POINTER(_ReasonContext)]
            create.restype = wintypes.HANDLE
            require = self._kernel.PowerSetRequest
            require.argtypes = [wintypes.HANDLE, ctypes.c_int]
            require.restype = wintypes.BOOL
            context = _ReasonContext(
                _POWER_REQUEST_CONTEXT_VERSION,
                _POWER_REQUEST_CONTEXT_SIMPLE_STRING,
                _Reason(text=self._reason),
            )
            request: int | None = create(ctypes.byref(context))
            if request is None or request == _INVALID_HANDLE:
                raise ctypes.WinError(ctypes.get_last_error())
            if not require(request, _POWER_REQUEST_SYSTEM_REQUIRED):
                error = ctypes.WinError(ctypes.get_last_error())
                self._close(request)
                raise error
            return request

        def _close(self, request: int) -> None:
            close = self._kernel.CloseHandle
            close.argtypes = [wintypes.HANDLE]
            close.restype = wintypes.BOOL
            close(request)

        def _set_execution_state(self, state: int) -> None:
            set_state = self._kernel.SetThreadExecutionState
            set_state.argtypes = [wintypes.DWORD]
            set_state.restype = wintypes.DWORD
            # It returns the state before, which is never zero.
            if not set_state(state):
                raise OSError("SetThreadExecutionState refuses")
