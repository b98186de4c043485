"""Keeps small what the threads of a long-running program leave behind in the heap."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Mapping

ARENAS = 1
"""One leaves nothing behind, and costs no time (docs/measurements.md)."""

# From glibc's malloc.h.
_M_ARENA_MAX = -8
_VARIABLE, _TUNABLES, _TUNABLE = "MALLOC_ARENA_MAX", "GLIBC_TUNABLES", "glibc.malloc.arena_max"


def limit_arenas(environment: Mapping[str, str], arenas: int = ARENAS) -> bool:
    """Let all threads share a few of glibc's arenas, by default up to eight a processor.

    What a thread that has ended leaves in its arena is of use only to those that share it.
    Call it before there are threads: what exists stays.

    Parameters
    ----------
    environment
        Where the user may have said how many; then nothing is changed.
    arenas
        How many at most, from 1.

    Returns
    -------
    bool
        Whether it was set: not where the C library is another one, as on Windows and macOS.
    """
    has_own = environment.get(_VARIABLE) or _TUNABLE in environment.get(_TUNABLES, "")
    if has_own or sys.platform != "linux":
        return False
    # musl has none.
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return mallopt is not None and bool(mallopt(_M_ARENA_MAX, arenas))
