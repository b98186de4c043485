"""Finds streams on the network, once or for as long as a program runs, and numbers equal ones.

People copy a source_id from an example into several scripts. The first sender has the stream's
own name, the second ``<name>_2`` and so on. A number is bound to the sender's computer, format and
shape, if these differ, so that the sender gets it again after a restart of it or the node.
"""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import pylsl
from pylsl.lib import lib

from biosensor_common.errors import SpecError
from biosensor_common.lsl.api_file import (
    LslOverrides,
    effective_config,
    home_folder,
    user_config_file,
)
from biosensor_common.lsl.predicates import EVERYTHING, any_of, of_user
from biosensor_common.stream_header import StreamHeader

LOOK_EVERY_S = 0.1
FORGET_AFTER_S = 5.0
"""liblsl still reports an outlet for this long after it has ended."""
OVERLAP_S = 1.0
"""A sender that replaces its own outlet may have both for so long."""
ANSWER_S = 3.0
"""An outlet that has not answered after so long is asked again."""
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
        As of `effective_config`.
    """
    path = user_config_file(os.environ, home_folder(), Path.cwd())
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


class Living:
    """Tells outlets that are alive from those that have ended but are still reported.

    A resolver reports only outlets that have answered since it began, so a new one is asked.
    """

    def __init__(self, predicate: str = EVERYTHING) -> None:
        self._predicate = predicate
        self._due_s: dict[str, float] = {}
        self._living: set[str] = set()
        self._asked: Network | None = None
        self._asked_s = 0.0

    def among(self, uids: Collection[str], now_s: float) -> set[str]:
        """Return those that are known to be alive; call it a few times a second.

        Parameters
        ----------
        uids
            All outlets in doubt. Each is asked once it has been in doubt for `OVERLAP_S`.
        now_s
            On any steady clock.
        """
        self._due_s = {uid: self._due_s.get(uid, now_s + OVERLAP_S) for uid in uids}
        self._living &= self._due_s.keys()
        due = {uid for uid, due_s in self._due_s.items() if due_s <= now_s} - self._living
        if self._asked is not None:
            answered = {info.uid() for info in self._asked.streams()}
            self._living |= {uid for uid in due & answered if self._due_s[uid] <= self._asked_s}
        if due <= self._living:
            self._asked = None
        elif self._asked is None or now_s - self._asked_s > ANSWER_S:
            self._asked, self._asked_s = Network(self._predicate), now_s
        return set(self._living)


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


def numbered(header: StreamHeader, number: int) -> StreamHeader:
    """Return the header of a stream with its number appended to the name."""
    if number == 1:
        return header
    name = f"{header.data_name}_{number}"
    return replace(header, data_name=name, chunk=name if header.chunk else "")


class _Place(NamedTuple):
    """Properties of a sender that stay the same over a restart."""

    host: str
    format: int
    channels: int
    rate: float


@dataclass(slots=True)
class _Number:
    place: _Place
    uid: str


class SenderNumbers:
    """The numbers of all senders, by stream identity."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, str, str], list[_Number]] = {}

    def number(self, info: pylsl.StreamInfo, live: Collection[str]) -> int:
        """Return a sender's number, from 1.

        Parameters
        ----------
        info
            Result of a resolver.
        live
            Uids of the senders that are served or shown now; their numbers are in use.
        """
        uid, place = info.uid(), _place_of(info)
        given = self._numbers.setdefault((info.source_id(), info.name(), info.type()), [])
        free = [each for each in given if each.uid not in live or each.uid == uid]
        of_same_place = [each for each in free if each.place == place]
        chosen = next(iter([*of_same_place, *free]), None)
        if chosen is None:
            chosen = _Number(place, uid)
            given.append(chosen)
        chosen.place, chosen.uid = place, uid
        return given.index(chosen) + 1


def by_start(info: pylsl.StreamInfo) -> tuple[float, str]:
    """Return a key that sorts senders by their start time, not by when they were found."""
    return info.created_at(), info.uid()


def _place_of(info: pylsl.StreamInfo) -> _Place:
    return _Place(
        info.hostname(), info.channel_format(), info.channel_count(), info.nominal_srate()
    )
