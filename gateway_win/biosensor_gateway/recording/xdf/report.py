"""The report on one recording: filled by the rules, formatted by the printers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from biosensor_gateway.recording.xdf.counters import RecordedCounters
from biosensor_gateway.recording.xdf.figures import MAX_UPTIME_S, Figures
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.recording.xdf.recording import RecordedStream, Recording
from biosensor_gateway.recording.xdf.sender_clock import Offset, SenderClock, plausible

LATE_S = 5.0
"""Streams of a good recording may start and stop this far apart, in s."""


@dataclass(frozen=True)
class Measured:
    """One stream with its statistics, and the agent's counts where available."""

    stream: RecordedStream
    figures: Figures
    counters: RecordedCounters | None = None

    @property
    def name(self) -> str:
        """The stream's name."""
        return self.stream.header.title

    @cached_property
    def _clock(self) -> SenderClock:
        # Behind a restart of the clock, statistics are on the recorder's clock already.
        return SenderClock(() if self.figures.offsets.resets else self.stream.clock_offsets)

    def recorder_s(self, stamp_s: float) -> float:
        """Convert a time of its statistics to the recorder's clock."""
        return float(self._clock.to_recorder(np.array([stamp_s]))[0])

    def own_s(self, time_s: float) -> float:
        """Convert a time on the recorder's clock to the clock of its statistics."""
        return float(self._clock.to_sender(np.array([time_s]))[0])


class Ends(NamedTuple):
    """First and last sample of a stream on the recorder's clock, in s."""

    header: RecordedHeader
    is_on_clock: bool  # Whether it is on an LSL clock, see `figures.clock_error`.
    first_s: float
    last_s: float


@dataclass(frozen=True, slots=True)
class Extent:
    """Start and end of a recording on the recorder's clock, in s.

    They are the first and last sample of all streams on the LSL clock, or of all streams if none
    is; where clock offsets go on alone, the last of these is the end. Our own streams without a
    rate, and those about the state of a device, count only if there are no others: a device may
    compute a heart rate for seconds, a web experiment sends a marker when it can, and a device's
    state may be older than the recording.
    """

    begin: float
    end: float

    @property
    def length_s(self) -> float:
        """Seconds from start to end."""
        return self.end - self.begin

    def since_begin(self, stamp: float, measured: Measured) -> float:
        """Convert a timestamp of a stream to seconds since the start of the recording.

        In a stream on another clock, times count from its own first sample.
        """
        if measured.figures.clock_error:
            return stamp - (measured.figures.first or 0.0)
        return measured.recorder_s(stamp) - self.begin


def extent(streams: Sequence[Measured]) -> Extent:
    """Return the extent of a recording."""
    ends = [
        Ends(each.stream.header, not figures.clock_error, *map(each.recorder_s, bounds))
        for each in streams
        for figures in [each.figures]
        if (bounds := figures.bounds) is not None
    ]
    return extent_of(ends, last_asked(each.stream.clock_offsets for each in streams))


def extent_of(ends: Sequence[Ends], asked_s: float) -> Extent:
    """Return the extent of streams; from 0 to 0 if none has samples.

    Parameters
    ----------
    asked_s
        See `last_asked`.
    """
    on_clock = [each for each in ends if each.is_on_clock]
    present = on_clock or ends
    timely = [each for each in present if not each.header.may_be_older]
    steady = [each for each in timely if not _comes_when_it_comes(each.header)]
    counted = steady or timely or present
    if not counted:
        return Extent(0.0, 0.0)
    begin, end = min(each.first_s for each in counted), max(each.last_s for each in counted)
    # If all that is told comes late, the recorder's clock offsets show that it went on.
    is_later = bool(on_clock) and LATE_S < asked_s - end < MAX_UPTIME_S
    return Extent(begin, asked_s if is_later else end)


def last_asked(offsets: Iterable[Sequence[Offset]]) -> float:
    """Return when the recorder noted the last clock offset, on its own clock in s; 0 if never.

    Parameters
    ----------
    offsets
        Of each stream.
    """
    lasts = (plausible(each)[-1:] for each in offsets)
    return max((sum(offset) for last in lasts for offset in last), default=0.0)


def _comes_when_it_comes(header: RecordedHeader) -> bool:
    return header.is_ours and not header.is_regular


@dataclass(frozen=True, slots=True)
class Report:
    """Everything found out about a recording; `findings` are sorted by subject."""

    recording: Recording
    streams: tuple[Measured, ...]
    extent: Extent
    findings: tuple[Finding, ...]

    @property
    def is_good(self) -> bool:
        """Whether there are no errors; warnings and notes do not count."""
        return all(finding.level is not Level.ERROR for finding in self.findings)

    @property
    def can_be_salvaged(self) -> bool:
        """Whether the file is truncated, damaged or joined, but samples can be read.

        A last sample with a timestamp far away counts as damage, as do samples written twice.
        """
        if any(each.code == "going-on" for each in self.findings):
            return False
        recording = self.recording
        is_open = any(each.is_unclosed for each in recording.streams)
        damages = [each for each in recording.damages if not each.is_foreign]
        is_broken = bool(damages or recording.orphans or recording.renumbered)
        is_broken |= any(each.repeated for each in recording.streams)
        ends = (each.figures.pace for each in self.streams)
        is_broken |= any(pace is not None and pace.ends_astray for pace in ends)
        # Of a header that cannot be read, salvaging may fix the form.
        has_samples = bool(recording.orphans) or any(e.sample_count for e in recording.streams)
        return (is_broken or is_open) and has_samples
