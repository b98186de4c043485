"""Finds streams on the network, once or for as long as a program runs.

They answer in waves, and of many some answer late, so nobody relies on one look.
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
"""An outlet that has just died is still reported for so long."""

Streams = Mapping[str, pylsl.StreamInfo]
"""By their uids."""


def configure_lsl(overrides: LslOverrides) -> Path | None:
    """Set the LSL configuration of this process; call it before any other LSL call.

    Returns
    -------
    Path or None
        The user's own file that was taken over, if there is one.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` or ``MALFORMED``, for that file.
    """
    path = user_config_file(os.environ, Path.home(), Path.cwd())
    pylsl.set_config_content(effective_config(path, overrides))
    return path


class Network:
    """Follows the streams that fit a predicate, in threads of liblsl, until it is deleted."""

    def __init__(self, predicate: str = EVERYTHING) -> None:
        self._resolver = pylsl.ContinuousResolver(pred=predicate, forget_after=FORGET_AFTER_S)

    def streams(self) -> list[pylsl.StreamInfo]:
        """Return those that are there, without descriptions, in the order of their start.

        So every program has them in the same order, whichever was found first. An outlet that
        has ended is among them for some seconds.
        """
        return sorted(self._resolver.results(), key=by_start)


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


def search(
    is_enough: Callable[[Streams, float], bool], predicate: str = EVERYTHING
) -> list[pylsl.StreamInfo]:
    """Look until it is enough; return all streams that answered, also those that have ended since.

    Parameters
    ----------
    is_enough
        Is given what has answered so far, and since how many seconds it is looked for.
    """
    network = Network(predicate)
    begun_s = time.monotonic()
    found: dict[str, pylsl.StreamInfo] = {}
    while True:
        time.sleep(LOOK_EVERY_S)
        # A resolver gives a stream again at each look.
        found |= {info.uid(): info for info in network.streams()}
        if is_enough(found, time.monotonic() - begun_s):
            return list(found.values())
