"""Reads the power scheme of Windows, whatever the language of the system."""

from __future__ import annotations

import ctypes
import sys
from uuid import UUID

# Of winnt.h: GUID_SLEEP_SUBGROUP and GUID_STANDBY_TIMEOUT.
_SLEEP = UUID("238c9fa8-0aad-41ed-83f4-97be242c8f20")
_STANDBY_TIMEOUT = UUID("29f6c1db-86da-48c5-9fdb-f2b67b1f44da")


def sleep_timeout_s() -> int | None:
    """Return after how many idle seconds on mains Windows sleeps; 0 never, None unknown."""
    if sys.platform != "win32":
        return None
    scheme = ctypes.c_void_p()
    seconds = ctypes.c_uint32()
    try:
        library = ctypes.WinDLL("powrprof")
        if library.PowerGetActiveScheme(None, ctypes.byref(scheme)):
            return None
        failed = library.PowerReadACValueIndex(
            None, scheme, _guid(_SLEEP), _guid(_STANDBY_TIMEOUT), ctypes.byref(seconds)
        )
        ctypes.WinDLL("kernel32").LocalFree(scheme)
    except (OSError, AttributeError):
        # Systems that are no full Windows have no schemes.
        return None
    return None if failed else seconds.value


def _guid(value: UUID) -> ctypes.Array[ctypes.c_char]:
    return ctypes.create_string_buffer(value.bytes_le, len(value.bytes_le))
