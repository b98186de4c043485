"""Finds streams on the network, once or for as long as a program runs.

Streams answer in waves, and some of many answer late, so a single query is not enough.
"""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import pylsl
from pylsl.lib import lib

from biosensor_common.errors import SpecError
from biosensor_common.lsl.namesakes import by_start
from biosensor_common.lsl.predicates import EVERYTHING, any_of, of_user
from biosensor_common.lsl_config import LslOverrides, effective_config, user_config_file

LOOK_EVERY_S = 0.1
FORGET_AFTER_S = 5.0
"""liblsl still reports an outlet for this long after it has ended."""

Streams = Mapping[str, pylsl.StreamInfo]
"""Streams by their uids."""


def configure_lsl(overrides: LslOverrides) -> Path | None:
    """Set the LSL configuration of this process; call it before any other LSL call.

    Returns
    -------
    Path or None
        The user's own file that was merged in, if there is one.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` or ``MALFORMED``, for that file.
    """
    path = user_config_file(os.environ, Path.home(), Path.cwd())
    pylsl.set_config_content(effective_config(path, overrides))
    return path


class Network:
    """Tracks the streams that match a predicate, in threads of liblsl, until it is deleted."""

    def __init__(self, predicate: str = EVERYTHING) -> None:
        self._resolver = pylsl.ContinuousResolver(pred=predicate, forget_after=FORGET_AFTER_S)

    def streams(self) -> list[pylsl.StreamInfo]:
        """Return the present streams, without descriptions, in the order of their start.

        All programs therefore have them in the same order. An outlet that has ended is still
        included for some seconds.
        """
        return sorted(self._resolver.results(), key=by_start)


def matches_query(info: pylsl.StreamInfo, query: str) -> bool:
    """Whether a stream matches an LSL query, such as ``type='EEG' and starts-with(name,'p01')``.

    A query that liblsl cannot parse matches nothing.
    """
    function = lib.lsl_stream_info_matches_query
    function.restype = ctypes.c_int32
    function.argtypes = (ctypes.c_void_p, ctypes.c_char_p)
    return bool(function(info.obj, query.encode()))


def is_query(query: str) -> bool:
    """Whether liblsl can parse a query (XPath 1.0 over the fields of a stream)."""
    any_stream = pylsl.StreamInfo("any", "any", 1, 0.0, "float32", "any")
    try:
        return matches_query(any_stream, any_of(of_user(query), EVERYTHING))
    except SpecError:
        return False


def search(
    is_enough: Callable[[Streams, float], bool], predicate: str = EVERYTHING
) -> list[pylsl.StreamInfo]:
    """Search until *is_enough* returns true; return all streams that answered, also ended ones.

    Parameters
    ----------
    is_enough
        Called with the streams that have answered so far and the seconds since the start.
    """
    network = Network(predicate)
    begun_s = time.monotonic()
    found: dict[str, pylsl.StreamInfo] = {}
    while True:
        time.sleep(LOOK_EVERY_S)
        # A resolver returns the same stream again at each call.
        found |= {info.uid(): info for info in network.streams()}
        if is_enough(found, time.monotonic() - begun_s):
            return list(found.values())
