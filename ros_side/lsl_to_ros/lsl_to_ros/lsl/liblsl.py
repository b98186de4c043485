"""Calls functions of liblsl that pylsl does not offer."""

from __future__ import annotations

import ctypes
import re

import pylsl
from pylsl.lib import lib

_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")

# Calls through it keep the interpreter's lock. Giving it up takes longer than these
# calls do, and the next of many reading threads would take it.
_quick = ctypes.PyDLL(None, handle=lib._handle)  # noqa: SLF001 - the way that ctypes documents
_quick.lsl_local_clock.restype = ctypes.c_double
_quick.lsl_samples_available.restype = ctypes.c_uint32
_quick.lsl_samples_available.argtypes = (ctypes.c_void_p,)


def local_clock() -> float:
    """Return this machine's LSL time in seconds."""
    return _quick.lsl_local_clock()


def samples_available(inlet: pylsl.StreamInlet) -> int:
    """Count the samples that an inlet holds; 0 also for one whose stream is lost."""
    return _quick.lsl_samples_available(inlet.obj)


def clock_inlet(info: pylsl.StreamInfo) -> pylsl.StreamInlet:
    """Open an inlet that is only asked for the sender's clock, never for data.

    Raises
    ------
    RuntimeError
        If liblsl can open none.
    """
    return pylsl.StreamInlet(info, max_buflen=1, recover=False)


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
    is_closed = "\0" not in query and _has_balanced_brackets(query)
    return is_closed and matches_query(any_stream, f"({query}) or true()")


def _has_balanced_brackets(query: str) -> bool:
    """Whether no bracket closes one that stands before the query."""
    depth = 0
    for character in _QUOTED.sub("", query):
        depth += {"(": 1, ")": -1}.get(character, 0)
        if depth < 0:
            return False
    return depth == 0
