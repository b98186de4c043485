"""Converts moments of a recording to the time of day.

LSL's clock starts when a computer boots. Therefore the agent and the node regularly write pairs of
LSL time and Unix time to their event streams: the element ``clock`` with ``lsl_s`` and
``unix_ns``. Without these, only the recorder's start date is known, in whole seconds.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.naming import AGENT, NODE
from biosensor_common.ros_clock import NS_PER_S, STEP_NS, ClockPair, read_clock_pair
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.xdf.findings import CLOCK_SET_S
from biosensor_gateway.recording.xdf.header import FileClock

EVENTS = "events"
DATE_RESOLUTION_S = 1.0
NO_ZONE_RESOLUTION_S = 26 * 3600.0
"""Error of a date without a time zone, which is interpreted in this computer's zone."""
# The node's clock first: a bag uses it, so a recording exported to a bag should, too.
_TELLERS = (NODE, AGENT)


@dataclass(frozen=True)
class WallClock:
    """Relation between the recorder's LSL clock and the time of day.

    Attributes
    ----------
    source
        Origin of the times: name of a stream, ``"date"`` for the recorder's start date, or
        ``"file"`` for the header of a recording imported from a bag.
    resolution_s
        Maximum error, depending on the source.
    times : ndarray of float64, shape (n_pairs,)
        Moments on the recorder's LSL clock at which Unix time is known, ascending, in s.
    offsets_ns : ndarray of int64, shape (n_pairs,)
        Unix time minus LSL time at these moments.
    """

    source: str
    resolution_s: float
    times: NDArray[np.float64]
    offsets_ns: NDArray[np.int64]

    @property
    def doubt(self) -> str:
        """Error or jump of the time of day, as the end of a sentence; empty if exact."""
        if self.resolution_s >= NO_ZONE_RESOLUTION_S:
            return (
                "may be hours off: the recorder's date has no time zone, and was taken as one of "
                "this computer's"
            )
        if self.resolution_s:
            return (
                f"is only accurate to {self.resolution_s:g} s, because only the recorder's date "
                "is known"
            )
        steps_s = np.diff(self.offsets_ns) / NS_PER_S
        largest = max(steps_s, key=abs, default=0.0)
        if abs(largest) > CLOCK_SET_S:
            return (
                f"jumps by {largest:+.1f} s: a computer slept meanwhile, or its clock was set; "
                "times on the LSL clock do not"
            )
        return ""

    def to_unix_ns(self, times: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return Unix time in ns.

        The offset is interpolated linearly between pairs and constant outside of them. Where the
        clock was set, by more than a millisecond, the new offset applies from its first pair on.

        Parameters
        ----------
        times : ndarray of float64, shape (n,)
            Finite, on the recorder's LSL clock, in s.
        """
        knots, relative_ns = self._course
        whole = np.floor(times)
        lsl_ns = whole.astype(np.int64) * NS_PER_S
        lsl_ns += np.rint((times - whole) * NS_PER_S).astype(np.int64)
        moved = np.rint(np.interp(times, knots, relative_ns)).astype(np.int64)
        return np.asarray(lsl_ns + self.offsets_ns[0] + moved)

    @cached_property
    def _course(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """LSL times in s, and the offsets relative to the first one, in ns."""
        # Where the clock was set, a time occurs twice, with the offset before and after.
        relative = (self.offsets_ns - self.offsets_ns[0]).astype(np.float64)
        set_at = np.flatnonzero(np.abs(np.diff(relative)) > STEP_NS) + 1
        knots = np.insert(self.times, set_at, self.times[set_at])
        return knots, np.insert(relative, set_at, relative[set_at - 1])

    def to_lsl_s(self, unix_ns: int) -> float:
        """Convert a Unix time to the recorder's LSL clock, in s."""
        return float(self.to_lsl(np.array([unix_ns]))[0])

    def to_lsl(self, unix_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Convert Unix times to the recorder's LSL clock, in s.

        If a clock that was set back showed a time twice, the later moment is returned.

        Parameters
        ----------
        unix_ns : ndarray of int64, shape (n,)
        """
        base_ns = self.offsets_ns[0]
        shown = (unix_ns - base_ns) / NS_PER_S
        set_at = np.flatnonzero(np.abs(np.diff(self.offsets_ns)) > STEP_NS) + 1
        lsl_s = np.empty(len(unix_ns))
        for part in np.split(np.arange(len(self.times)), set_at):
            times = self.times[part]
            clock = times + (self.offsets_ns[part] - base_ns) / NS_PER_S
            is_later = shown >= clock[0] if part[0] else np.ones(len(shown), np.bool_)
            within = np.clip(shown, clock[0], clock[-1])
            found = np.asarray(np.interp(within, clock, times), np.float64) + (shown - within)
            lsl_s[is_later] = found[is_later]
        return lsl_s


def find_wall_clock(
    streams: Sequence[Stream], begun: str, begin_s: float, file_clock: FileClock | None = None
) -> WallClock | None:
    """Find the time of day of a recording; None if it is unknown.

    Parameters
    ----------
    begun
        The recorder's text for the start time.
    begin_s
        LSL time of the first sample.
    file_clock
        The clock in the file's header, if it was imported from a bag.
    """
    for teller in _TELLERS:
        told = [_of_stream(each) for each in streams if _is_told_by(each, teller)]
        best = max((each for each in told if each), key=lambda each: len(each.times), default=None)
        if best:
            return best
    if file_clock is not None:
        pairs = [(pair.lsl_s, pair) for pair in file_clock.pairs]
        return _of_pairs("file", file_clock.resolution_s, pairs)
    try:
        date = datetime.fromisoformat(begun)
    except ValueError:
        return None
    offset_ns = int(date.timestamp() * NS_PER_S) - round(begin_s * NS_PER_S)
    resolution_s = NO_ZONE_RESOLUTION_S if date.tzinfo is None else DATE_RESOLUTION_S
    return WallClock("date", resolution_s, np.array([begin_s]), np.array([offset_ns]))


def _is_told_by(stream: Stream, teller: str) -> bool:
    header = stream.header
    # The times in a replay are from an earlier day.
    if header.identity is None or header.replay is not None:
        return False
    return header.identity.sensor == teller and header.data_name == EVENTS


def _of_stream(stream: Stream) -> WallClock | None:
    pairs = sorted(_pairs(stream))
    if not pairs:
        return None
    return _of_pairs(stream.header.name, 0.0, pairs)


def _of_pairs(
    source: str, resolution_s: float, pairs: Sequence[tuple[float, ClockPair]]
) -> WallClock:
    times = np.array([time_s for time_s, _ in pairs])
    offsets_ns = np.array([pair.unix_ns - round(time_s * NS_PER_S) for time_s, pair in pairs])
    return WallClock(source, resolution_s, times, offsets_ns)


def _pairs(stream: Stream) -> Iterator[tuple[float, ClockPair]]:
    """Yield each pair with its moment on the recorder's clock."""
    for samples in stream.blocks():
        texts: Sequence[Sequence[Any]] = samples.values if isinstance(samples.values, list) else ()
        for time_s, stamp, (text, *_) in zip(samples.times, samples.stamps, texts, strict=False):
            pair = read_clock_pair(_json(text))
            if pair is not None:
                yield float(time_s - stamp + pair.lsl_s), pair


def _json(text: str) -> object:
    try:
        return json.loads(text)
    except ValueError:
        return None
