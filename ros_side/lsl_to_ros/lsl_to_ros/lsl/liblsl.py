"""Calls functions of liblsl that pylsl does not offer."""

from __future__ import annotations

import ctypes
from typing import Any, Self

import numpy as np
import pylsl
from numpy.typing import NDArray
from pylsl import util
from pylsl.lib import lib

from biosensor_common.errors import SpecError
from biosensor_common.lsl.predicates import EVERYTHING, any_of, of_user

# Calls through it keep the interpreter's lock. Giving it up takes longer than these
# calls do, and the next of many reading threads would take it.
_quick = ctypes.PyDLL(None, handle=lib._handle)  # noqa: SLF001 - the way that ctypes documents
_quick.lsl_local_clock.restype = ctypes.c_double
_quick.lsl_samples_available.restype = ctypes.c_uint32
_quick.lsl_samples_available.argtypes = (ctypes.c_void_p,)
# int64 is left to pylsl: which of C's types it is depends on the system.
_PULLS = {
    np.dtype(kind): getattr(_quick, f"lsl_pull_chunk_{letter}")
    for kind, letter in {"f4": "f", "f8": "d", "i4": "i", "i2": "s", "i1": "c"}.items()
}
for _pull in _PULLS.values():
    _pull.restype = ctypes.c_ulong
    _pull.argtypes = (
        ctypes.c_void_p,
        ctypes.c_void_p,
        ctypes.c_void_p,
        ctypes.c_ulong,
        ctypes.c_ulong,
        ctypes.c_double,
        ctypes.c_void_p,
    )


def local_clock() -> float:
    """Return this machine's LSL time in seconds."""
    return _quick.lsl_local_clock()


def samples_available(inlet: pylsl.StreamInlet) -> int:
    """Count the samples that an inlet holds; 0 also for one whose stream is lost."""
    return _quick.lsl_samples_available(inlet.obj)


class WaitingNumbers:
    """Takes numbers that have come out of one inlet, without waiting.

    Parameters
    ----------
    most
        Samples that are ever asked for at once.

    Attributes
    ----------
    samples, stamps
        What was taken last stands at their beginning; shape [most, channels] and [most].
    """

    def __init__(self, inlet: pylsl.StreamInlet, dtype: np.dtype[Any], most: int) -> None:
        self.samples: NDArray[Any] = np.empty((most, inlet.channel_count), dtype)
        self.stamps: NDArray[np.float64] = np.empty(most)
        self._error = ctypes.c_int()
        self._channels = inlet.channel_count
        self._pull = _PULLS[dtype]
        self._where = inlet.obj, self.samples.ctypes.data, self.stamps.ctypes.data
        self._error_at = ctypes.addressof(self._error)

    @classmethod
    def of(cls, inlet: pylsl.StreamInlet, most: int) -> Self | None:
        """Return that of an inlet; None if its samples are texts, or numbers of another kind."""
        if inlet.np_dtype is None or np.dtype(inlet.np_dtype) not in _PULLS:
            return None
        return cls(inlet, np.dtype(inlet.np_dtype), most)

    def take(self, count: int) -> int:
        """Take at most *count* samples; return how many there were.

        Raises
        ------
        LostError
            The stream has ended.
        """
        values = self._pull(*self._where, count * self._channels, count, 0.0, self._error_at)
        util.handle_error(self._error)
        return values // self._channels


def matches_query(info: pylsl.StreamInfo, query: str) -> bool:
    """Whether a stream fits an LSL query, such as ``type='EEG' and starts-with(name,'p01')``.

    A query that liblsl cannot read fits nothing.
    """
    function = lib.lsl_stream_info_matches_query
    function.restype = ctypes.c_int32
    function.argtypes = (ctypes.c_void_p, ctypes.c_char_p)
    return bool(function(info.obj, query.encode()))


def is_query(query: str) -> bool:
    """Whether liblsl can read a query (XPath 1.0 over the fields of a stream)."""
    any_stream = pylsl.StreamInfo("any", "any", 1, 0.0, "float32", "any")
    try:
        return matches_query(any_stream, any_of(of_user(query), EVERYTHING))
    except SpecError:
        return False
