"""The report on one recording: filled by the rules, formatted by the printers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from biosensor_gateway.recording.xdf.counters import RecordedCounters
from biosensor_gateway.recording.xdf.figures import MAX_UPTIME_S, Figures
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.recording.xdf.recording import RecordedStream, Recording
from biosensor_gateway.recording.xdf.sender_clock import is_reading, plausible

LATE_S = 5.0
"""Streams of a good recording may start and stop this far apart, in s."""


@dataclass(frozen=True, slots=True)
class Measured:
    """One stream with its statistics, and the agent's counts where available."""

    stream: RecordedStream
    figures: Figures
    counters: RecordedCounters | None = None

    @property
    def name(self) -> str:
        """The stream's name."""
        return self.stream.header.title

    @property
    def recorder_offset_s(self) -> float:
        """Offset from the times in its statistics to the recorder's clock, in s."""
        offsets = [each for _, each in self.stream.clock_offsets if is_reading(each)]
        return offsets[0] if offsets and not self.figures.offsets.resets else 0.0


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
        return stamp + measured.recorder_offset_s - self.begin


def extent(streams: Sequence[Measured]) -> Extent:
    """Compute the extent of a recording; from 0 to 0 if no stream has samples."""
    on_clock = [each for each in streams if not each.figures.clock_error]
    present = _bounds(on_clock) or _bounds(streams)
    timely = [bound for bound in present if not bound[0].may_be_older]
    bounds = [bound for bound in timely if not _comes_when_it_comes(bound[0])] or timely or present
    if not bounds:
        return Extent(0.0, 0.0)
    begin, end = min(begin for _, begin, _ in bounds), max(end for _, _, end in bounds)
    asked_s = last_asked(streams)
    # If all that is told comes late, the recorder's clock offsets show that it went on.
    is_later = bool(on_clock) and LATE_S < asked_s - end < MAX_UPTIME_S
    return Extent(begin, asked_s if is_later else end)


def last_asked(streams: Sequence[Measured]) -> float:
    """Return when the recorder noted the last clock offset, on its own clock in s; 0 if never."""
    lasts = (plausible(each.stream.clock_offsets)[-1:] for each in streams)
    return max((sum(offset) for last in lasts for offset in last), default=0.0)


def _bounds(streams: Sequence[Measured]) -> list[tuple[RecordedHeader, float, float]]:
    return [
        (each.stream.header, figures.first + offset_s, figures.last + offset_s)
        for each in streams
        for figures, offset_s in [(each.figures, each.recorder_offset_s)]
        if figures.first is not None and figures.last is not None
    ]


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

        A last sample with a timestamp far away counts as damage.
        """
        if any(each.code == "going-on" for each in self.findings):
            return False
        recording = self.recording
        is_open = any(each.is_unclosed for each in recording.streams)
        damages = [each for each in recording.damages if not each.is_foreign]
        is_broken = bool(damages or recording.orphans or recording.renumbered)
        ends = (each.figures.pace for each in self.streams)
        is_broken |= any(pace is not None and pace.ends_astray for pace in ends)
        # Of a header that cannot be read, salvaging may fix the form.
        has_samples = bool(recording.orphans) or any(e.sample_count for e in recording.streams)
        return (is_broken or is_open) and has_samples
