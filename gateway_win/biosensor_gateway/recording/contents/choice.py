"""Selects streams, a time range or a participant of a recording."""

from __future__ import annotations

import heapq
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.ros_clock import NS_PER_S
from biosensor_gateway.recording.contents.contents import Contents
from biosensor_gateway.recording.contents.stream import Samples, Stream


def merged(
    streams: Iterable[Stream], begin_s: float, end_s: float
) -> Iterator[tuple[Stream, Samples]]:
    """Yield chunks of samples of all streams, ordered by the time of their first sample.

    One chunk per stream is kept in memory. Within a stream, the order of the file is kept.
    """

    def timed(place: int, stream: Stream) -> Iterator[tuple[float, int, Stream, Samples]]:
        for samples in stream.blocks(begin_s, end_s):
            yield float(samples.times[0]), place, stream, samples

    runs = (timed(place, stream) for place, stream in enumerate(streams))
    for _, _, stream, samples in heapq.merge(*runs, key=lambda each: each[:2]):
        yield stream, samples


# 12.5, 1:02.5 or 1:00:02.5
_SPAN = re.compile(r"(?:(?:(\d+):)?(\d{1,2}):)?(\d+(?:\.\d+)?)")
_MOST_NAMES = 8
BATCH = 1 << 14
"""Values processed at once: fewer cost calls, more do not fit into a processor's cache."""


@dataclass(frozen=True, slots=True)
class Selection:
    """A selection from a recording, as typed by the user."""

    streams: Sequence[str] = ()  # Names or source_ids, with `*` and `?`; none for all.
    # begin, end: seconds since the start of the recording, `h:mm:ss`, or a date and time of day
    # such as `2026-03-14T10:30:00`; empty for the start and end of the recording.
    begin: str = ""
    end: str = ""
    participant: str = ""  # Only streams of this participant; empty for all streams.
    without: str = ""  # Leave out streams of this participant.


@dataclass(frozen=True, slots=True)
class Chosen:
    """Selected streams and a time range of an open recording."""

    contents: Contents
    streams: tuple[Stream, ...]  # In the order of the file, including streams without samples.
    # begin_s, end_s: on the recorder's LSL clock; `end_s` is excluded, and infinite for the whole
    # rest.
    begin_s: float
    end_s: float
    batch: int = BATCH  # Number of values that exports process at once.

    def samples(self, stream: Stream, *, as_recorded: bool = True) -> Iterator[Samples]:
        """Yield the samples of one stream in the time range, chunk by chunk."""
        return stream.blocks(self.begin_s, self.end_s, as_recorded=as_recorded)

    def merged(self) -> Iterator[tuple[Stream, Samples]]:
        """Yield chunks of samples of all streams in time order."""
        return merged(self.streams, self.begin_s, self.end_s)


def on_one_clock(chosen: Chosen) -> tuple[Chosen, tuple[Stream, ...]]:
    """Leave out streams that are not on an LSL clock, because their time is unknown.

    If all streams are like this, they are kept on their own clocks.

    Returns
    -------
    tuple
        The remaining selection, and the streams that were left out.
    """
    away = tuple(each for each in chosen.streams if each.clock_error)
    timed = tuple(each for each in chosen.streams if not each.clock_error)
    if not away or not any(each.sample_count for each in timed):
        return chosen, ()
    return replace(chosen, streams=timed), away


def choose(contents: Contents, selection: Selection) -> Chosen:
    """Resolve a user's selection.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if a stream or participant is not in the recording, or a time is invalid.
    """
    for person in filter(None, (selection.participant, selection.without)):
        _require_person(contents, person)
    streams = [each for each in contents.streams if _is_of(each, selection)]
    for pattern in selection.streams:
        if not any(each.fits(pattern) for each in streams):
            names = _listed({each.header.title for each in streams})
            message = f"there is no stream {pattern!r} in {contents.path}; {names}"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
    if selection.streams:
        streams = [each for each in streams if any(each.fits(fit) for fit in selection.streams)]
    begin_s = _moment(selection.begin, contents) if selection.begin else -math.inf
    end_s = _moment(selection.end, contents) if selection.end else math.inf
    if end_s <= begin_s:
        message = f"the end, {selection.end}, is not after the start, {selection.begin}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return Chosen(contents, tuple(streams), begin_s, end_s)


def _require_person(contents: Contents, person: str) -> None:
    people = {each.participant for each in contents.streams} - {""}
    if person not in people:
        message = f"no participant is called {person!r} in {contents.path}; {_listed(people)}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)


def _is_of(stream: Stream, selection: Selection) -> bool:
    person = stream.participant
    is_left_out = bool(selection.without) and person == selection.without
    return not is_left_out and (not selection.participant or person == selection.participant)


def _listed(names: set[str]) -> str:
    if not names:
        return "there are none"
    shown = sorted(names)[:_MOST_NAMES]
    rest = f" and {len(names) - len(shown)} more" if len(names) > len(shown) else ""
    return f"there is {', '.join(map(repr, shown))}{rest}"


def _moment(text: str, contents: Contents) -> float:
    if found := _SPAN.fullmatch(text):
        hours, minutes, seconds = (float(part or 0.0) for part in found.groups())
        return contents.begin_s + hours * 3600 + minutes * 60 + seconds
    try:
        date = datetime.fromisoformat(text)
    except ValueError:
        message = (
            f"{text!r} is not a time in a recording; "
            "use seconds as 90.5, 1:30.5, or a date as 2026-03-14T10:30:00"
        )
        raise ConfigError(ConfigReason.WRONG_VALUE, message) from None
    if contents.wall is None:
        message = f"{contents.path} does not contain the time of day; use seconds, not {text}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return contents.wall.to_lsl_s(round(date.timestamp() * NS_PER_S))
