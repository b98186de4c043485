"""Computes statistics from the timestamps and clock offsets of one stream."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from biosensor_common.device_clock import READING_LIMIT_S
from biosensor_common.quantities import ContentType
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.recording.xdf.pace import (
    FEWEST,
    MOST_LOST,
    SECTION,
    STEP_BACK_S,
    Cuts,
    Pace,
    find_pace,
    rate_of,
)
from biosensor_gateway.recording.xdf.recording import RecordedStream
from biosensor_gateway.recording.xdf.sender_clock import Offset, is_reading, runs_of

# Between timestamps further apart than this many periods, samples are missing.
GAP_PERIODS = 1.5
# Other programs often use the time at which they push, so their timestamps jitter.
FOREIGN_JITTER_S = 0.1
# A badly damaged stream may have very many gaps.
MOST_GAPS_LISTED = 100
# A timestamp further off is not on its computer's LSL clock.
MAX_STAMP_ERROR_S = 30.0
# LSL's clock starts when the computer boots, and no computer is assumed to run for longer.
MAX_UPTIME_S = 366 * 86400.0
# Unix times from 2001 to 2286.
_UNIX_S = (1e9, 1e10)


@dataclass(frozen=True, slots=True)
class Gap:
    """A gap in a regular stream.

    Attributes
    ----------
    after
        Timestamp of the last sample before it, on the stream's clock, in s.
    length_s
        Time between the samples on either side.
    lost
        Estimated number of lost samples.
    """

    after: float
    length_s: float
    lost: int


@dataclass(frozen=True, slots=True)
class Gaps:
    """All gaps of a stream; only the longest `MOST_GAPS_LISTED` are listed."""

    count: int = 0
    lost: int = 0
    total_s: float = 0.0
    listed: tuple[Gap, ...] = ()


@dataclass(frozen=True, slots=True)
class ClockOffsets:
    """Statistics of the offsets between a stream's clock and the recorder's, in s.

    Attributes
    ----------
    drift_ppm
        Slope of a straight line through the offsets between resets; None if there are fewer than
        two.
    scatter_s
        Largest deviation from that line.
    resets
        How often the clock restarted or was set.
    """

    count: int = 0
    lowest_s: float | None = None
    highest_s: float | None = None
    drift_ppm: float | None = None
    scatter_s: float | None = None
    resets: int = 0


@dataclass(frozen=True, slots=True)
class Figures:
    """Statistics of the samples of one stream.

    Attributes
    ----------
    first, last
        Earliest and latest timestamp on the stream's clock, in s, without outliers; None without
        samples. If the stream's clock restarted, all times are on the recorder's clock.
    backward_steps
        How often a timestamp is earlier than the previous one; in another program's regular
        stream, only if bursts and jitter do not explain it.
    bad_stamps
        Number of timestamps that are NaN or infinite.
    rate_hz
        Samples per second from first to last; None for fewer than two samples.
    rate_between_gaps_hz
        The same without the gaps; None also for irregular streams.
    clock_error
        Why the timestamps are not on the LSL clock; empty if they are.
    pace
        How the timestamps of another program deviate from a line; None where each timestamp is
        exact.
    found_hz
        Rate of a stream whose header names none, if its samples are evenly spaced.
    """

    first: float | None
    last: float | None
    backward_steps: int
    bad_stamps: int
    rate_hz: float | None
    rate_between_gaps_hz: float | None
    gaps: Gaps
    offsets: ClockOffsets
    nan_shares: tuple[float, ...]
    clock_error: str
    pace: Pace | None = None
    found_hz: float | None = None

    @property
    def span_s(self) -> float:
        """Time from the first to the last sample, 0 without samples."""
        return 0.0 if self.first is None or self.last is None else self.last - self.first


def measure(stream: RecordedStream) -> Figures:
    """Compute all statistics of one stream."""
    # Times in a damaged file may overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        return _measure(stream)


def _measure(stream: RecordedStream) -> Figures:
    stamps = stream.stamps
    finite = own = stamps[np.isfinite(stamps)]
    offsets = stream.clock_offsets
    clock = summarise_offsets(offsets)
    if clock.resets:
        # In its own timestamps, a clock restart would look like a gap or a step back.
        stamps = stream.times()
        finite = stamps[np.isfinite(stamps)]
    count = max(1, stream.sample_count)
    pace = None
    header = stream.header
    found_hz = rate_of(stamps) if may_have_rate(header) else None
    if found_hz is not None:
        header = replace(header, rate=found_hz)
    is_ordered = not (len(own) and order_error(header, own, len(own)))
    if header.is_regular and not is_exact(header) and len(finite) > 1 and is_ordered:
        pace = find_pace(stamps, header.rate)
        gaps = _gaps_of(pace, stamps)
        finite = np.delete(stamps, pace.stray)
        finite = finite[np.isfinite(finite)]
        rate_between_gaps_hz: float | None = 1.0 / pace.period_s
        backward_steps = pace.odd_steps_back
    else:
        gaps = find_gaps(finite, header) if is_ordered else Gaps()
        rate_between_gaps_hz = _rate_between_gaps(finite, gaps, header) if is_ordered else None
        backward_steps = int(np.count_nonzero(finite[1:] < finite[:-1])) if is_ordered else 0
    first, last = (float(finite.min()), float(finite.max())) if len(finite) else (None, None)
    return Figures(
        first=first,
        last=last,
        backward_steps=backward_steps,
        bad_stamps=len(stamps) - int(np.isfinite(stamps).sum()),
        rate_hz=_rate(finite),
        rate_between_gaps_hz=rate_between_gaps_hz,
        gaps=gaps,
        offsets=clock,
        nan_shares=tuple(float(share) for share in stream.nan_counts / count),
        clock_error=clock_error(header, offsets, own, len(own)) if len(own) else "",
        pace=pace,
        found_hz=found_hz,
    )


def may_have_rate(header: RecordedHeader) -> bool:
    """Whether a stream whose header names no rate may be a signal.

    Ours say what they mean, and intervals between beats are as even as the heart.
    """
    is_signal = not header.is_markers and header.content_type != ContentType.RR
    return is_signal and not header.is_regular and not header.is_ours


def is_exact(header: RecordedHeader) -> bool:
    """Whether each timestamp is exact: in our streams, and where samples may be missing."""
    return header.is_ours or header.can_drop_samples


def cuts_of(
    blocks: Iterable[NDArray[np.float64]], header: RecordedHeader, section: int = SECTION
) -> Cuts | None:
    """Find where runs begin in a regular stream whose single timestamps are inexact.

    Parameters
    ----------
    blocks
        Finite times of its samples in s; only read if the timestamps are inexact.
    section
        Number of samples analysed together.

    Returns
    -------
    Cuts or None
        None if the timestamps are exact, so single steps are enough; see `longest_step_s`.
    """
    if is_exact(header):
        return None
    cuts = Cuts(header.rate, section)
    for times in blocks:
        cuts.take(times)
    cuts.end()
    return cuts


def _gaps_of(pace: Pace, stamps: NDArray[np.float64]) -> Gaps:
    longest = sorted(pace.holes, key=lambda each: -each.length_s)[:MOST_GAPS_LISTED]
    return Gaps(
        len(pace.holes),
        sum(each.lost for each in pace.holes),
        sum(each.length_s for each in pace.holes),
        tuple(
            Gap(float(stamps[each.at - 1]), each.length_s, each.lost)
            for each in sorted(longest, key=lambda each: each.at)
        ),
    )


def longest_step_s(header: RecordedHeader) -> float:
    """Return the largest step between timestamps without a gap; infinite if irregular.

    Timestamps are exact in our own streams and where the header says that samples can be missing;
    elsewhere they may jitter.
    """
    if not header.is_regular:
        return math.inf
    return max(GAP_PERIODS / header.rate, 0.0 if is_exact(header) else FOREIGN_JITTER_S)


def find_gaps(stamps: NDArray[np.float64], header: RecordedHeader) -> Gaps:
    """Find the gaps of a regular stream.

    Parameters
    ----------
    stamps : ndarray, shape (n_samples,)
        Finite, in the order of the file.
    """
    steps = np.diff(stamps)
    places = np.flatnonzero(steps > longest_step_s(header))
    if not len(places):
        return Gaps()
    lengths = steps[places]
    lost = np.rint(np.minimum(lengths * header.rate, MOST_LOST)).astype(np.int64) - 1
    longest = np.sort(np.argsort(-lengths, kind="stable")[:MOST_GAPS_LISTED])
    listed = [
        Gap(float(stamps[places[at]]), float(lengths[at]), int(lost[at])) for at in longest.tolist()
    ]
    return Gaps(len(places), int(lost.sum()), float(lengths.sum()), tuple(listed))


def _rate(stamps: NDArray[np.float64]) -> float | None:
    span = float(stamps.max() - stamps.min()) if len(stamps) else 0.0
    return (len(stamps) - 1) / span if span > 0 else None


def _rate_between_gaps(
    stamps: NDArray[np.float64], gaps: Gaps, header: RecordedHeader
) -> float | None:
    if not header.is_regular or len(stamps) < 2:
        return None
    time_s = float(stamps.max() - stamps.min()) - gaps.total_s
    steps = len(stamps) - 1 - gaps.count
    return steps / time_s if time_s > 0 and steps > 0 else None


def summarise_offsets(offsets: Sequence[Offset]) -> ClockOffsets:
    """Compute range and drift of (time, offset) pairs in s, separately for each clock run.

    A single last offset, measured while the outlet was closing, is ignored.
    """
    runs = [run for _, run in runs_of(offsets)]
    if len(runs) > 1 and len(runs[-1]) == 1:
        del runs[-1]
    if not runs:
        return ClockOffsets(len(offsets))
    longest = max(runs, key=lambda run: run[-1][0] - run[0][0])
    strayed = [found for run in runs if (found := _drift_and_scatter(run)) is not None]
    told = _drift_and_scatter(longest)
    values = [offset for run in runs for _, offset in run]
    return ClockOffsets(
        len(offsets),
        min(values),
        max(values),
        None if told is None else told[0],
        max((scatter for _, scatter in strayed), default=None),
        len(runs) - 1,
    )


def _drift_and_scatter(run: Sequence[Offset]) -> tuple[float, float] | None:
    times, values = np.array(run).T
    centred = times - times.mean()
    spread = float(centred @ centred)
    if spread == 0:
        return None
    slope = float(centred @ (values - values.mean())) / spread
    return slope * 1e6, float(np.abs(values - values.mean() - slope * centred).max())


def clock_error(
    header: RecordedHeader,
    offsets: Sequence[tuple[float, float]],
    stamps: NDArray[np.float64],
    sample_count: int,
) -> str:
    """Return why timestamps are not on the LSL clock; empty if they are.

    Every clock offset contains the stream's own LSL time, and the header contains the time at
    which the outlet was created; the timestamps must be consistent with both.

    Parameters
    ----------
    stamps : ndarray of float64, shape (n,)
        Finite, in the order of the file; those of first and last sample of each chunk are enough.
    sample_count
        Of the stream.
    """
    if why := order_error(header, stamps, sample_count):
        return why
    first, last = float(stamps.min()), float(stamps.max())
    unix = " (they are unix time)" if _UNIX_S[0] < first < _UNIX_S[1] else ""
    # For an outlet that has just closed, LabRecorder writes a clock time of 0.
    times = [time for time, _ in offsets if time and is_reading(time)]
    if times:
        # The state of a device may have been measured long before the recording.
        early_s = 0.0 if header.may_be_older else min(times) - last
        error_s = max(first - max(times), early_s)
        if error_s > MAX_STAMP_ERROR_S:
            return f"its stamps are {seconds_text(error_s)} away from the LSL clock{unix}"
        return ""
    since = header.created_at if math.isfinite(header.created_at) else 0.0
    if last < since - MAX_STAMP_ERROR_S:
        return f"its stamps are {seconds_text(since - last)} older than the stream itself"
    if unix or first - since > MAX_UPTIME_S:
        away = seconds_text(first - since)
        return f"its stamps are {away} away from when the stream was made{unix}"
    return ""


def order_error(header: RecordedHeader, stamps: NDArray[np.float64], sample_count: int) -> str:
    """Say why stamps of a regular stream do not tell when a sample was measured; empty if they do.

    Parameters
    ----------
    stamps, sample_count
        See `clock_error`.
    """
    if not header.is_regular or sample_count < max(FEWEST, header.rate):
        return ""
    steps = np.diff(stamps)
    back, ahead = int(np.count_nonzero(steps < 0)), int(np.count_nonzero(steps > 0))
    if not back and not ahead:
        return "its stamps are all the same" if len(steps) else ""
    if back > ahead:
        return "its stamps decrease from sample to sample"
    # Those of a clock that was set step back now and then, those of no clock all the time.
    if np.count_nonzero(steps < -STEP_BACK_S) > max(3, len(steps) / 8):
        return "its stamps are in no order"
    return ""


def seconds_text(seconds: float, digits: int = 0) -> str:
    """Return a time for people, also one of a damaged stamp, which would have 300 digits."""
    return f"{seconds:.{digits}f} s" if abs(seconds) <= READING_LIMIT_S else f"{seconds:.3g} s"
