"""Computes statistics from the timestamps and clock offsets of one stream."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_common.device_clock import READING_LIMIT_S
from biosensor_common.quantities import ContentType, signal_type
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.recording.xdf.pace import (
    FEW_ASTRAY,
    FEWEST,
    MOST_LOST,
    SECTION,
    STEP_BACK_S,
    Cuts,
    Pace,
    rate_of,
    section_of,
)
from biosensor_gateway.recording.xdf.rate_changes import RateChange
from biosensor_gateway.recording.xdf.recording import RecordedStream
from biosensor_gateway.recording.xdf.sender_clock import Offset, is_reading, runs_of

# Between timestamps further apart than this many periods, samples are missing.
GAP_PERIODS = 1.5
# Other programs often use the time at which they push, so their timestamps jitter.
FOREIGN_JITTER_S = 0.1
FIRST = 1 << 18
"""The first samples of a stream, by which its rate is found if its header names none."""
# A badly damaged stream may have very many gaps.
MOST_GAPS_LISTED = 100
# A timestamp further off is not on its computer's LSL clock.
MAX_STAMP_ERROR_S = 30.0
# LSL's clock starts when the computer boots, and no computer is assumed to run for longer.
MAX_UPTIME_S = 366 * 86400.0
# A stamp further from all that was measured of a clock while it was recorded is not that clock's.
FAR_OFF_S = 86400.0
# Timestamps that differ less from a straight line are as good as most clocks, in s.
_LEAST_BEND_S = 0.05
# No recording of a second or more is this short, also where stamps are not quite equal.
_NO_TIME_S = 1e-6
# Unix times from 2001 to 2286.
_UNIX_S = (1e9, 1e10)


@dataclass(frozen=True, slots=True)
class Gap:
    """A gap in a regular stream."""

    after: float  # Timestamp of the last sample before it, on the stream's clock, in s.
    length_s: float  # Time between the samples on either side.
    lost: int  # Estimated number of lost samples.


@dataclass(frozen=True, slots=True)
class Gaps:
    """All gaps of a stream; only the longest `MOST_GAPS_LISTED` are listed."""

    count: int = 0
    lost: int = 0
    total_s: float = 0.0
    listed: tuple[Gap, ...] = ()


@dataclass(frozen=True, slots=True)
class ClockOffsets:
    """Statistics of the offsets between a stream's clock and the recorder's, in s."""

    count: int = 0
    lowest_s: float | None = None
    highest_s: float | None = None
    # Slope of a straight line through the offsets between resets; None if there are fewer than two.
    drift_ppm: float | None = None
    scatter_s: float | None = None  # Largest deviation from that line.
    resets: int = 0  # How often the clock restarted or was set.


class Bend(NamedTuple):
    """How far timestamps are from a straight line, because the rate is not constant."""

    away_s: float
    stamp_s: float  # A timestamp where they are.


@dataclass(frozen=True, slots=True)
class Figures:
    """Statistics of the samples of one stream."""

    # first, last: earliest and latest timestamp on the stream's clock, in s, without outliers; None
    # without samples. If the stream's clock restarted, all times are on the recorder's clock.
    first: float | None
    last: float | None
    # How often a timestamp is earlier than the previous one; in another program's regular stream,
    # only if bursts and jitter do not explain it.
    backward_steps: int
    bad_stamps: int  # Number of timestamps that are NaN or infinite.
    rate_hz: float | None  # Samples per second from first to last; None for fewer than two samples.
    # The same without the gaps; None also for irregular streams.
    rate_between_gaps_hz: float | None
    gaps: Gaps
    offsets: ClockOffsets
    nan_shares: tuple[float, ...]
    clock_error: str  # Why the timestamps are not on the LSL clock; empty if they are.
    # How the timestamps of another program deviate from a line; None where each timestamp is exact.
    pace: Pace | None = None
    # Rate of a stream whose header names none, if its samples are evenly spaced.
    found_hz: float | None = None
    # Gaps in which the device was paused, see `event_rules.without_pauses`; not among `gaps`.
    pauses: Gaps = Gaps()
    furthest_back_s: float = 0.0  # Largest of these steps back.
    part_error: str = ""
    """How many timestamps are not on the LSL clock, where others are; empty if none."""
    rate_changes: tuple[RateChange, ...] = ()
    bend: Bend | None = None  # None if its timestamps lie on straight lines.

    @property
    def bounds(self) -> tuple[float, float] | None:
        """`first` and `last`; None without samples."""
        return None if self.first is None or self.last is None else (self.first, self.last)

    @property
    def span_s(self) -> float:
        """Time from the first to the last sample, 0 without samples."""
        return 0.0 if self.bounds is None else self.bounds[1] - self.bounds[0]


def measure(stream: RecordedStream) -> Figures:
    """Compute all statistics of one stream."""
    # Times in a damaged file may overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        return _measure(stream)


def _measure(stream: RecordedStream) -> Figures:
    own = Course.of(stream.stamps_in_blocks())
    offsets = stream.clock_offsets
    clock = summarise_offsets(offsets)
    # In its own timestamps, a clock restart would look like a gap or a step back.
    blocks = stream.times_in_blocks if clock.resets else stream.stamps_in_blocks
    header = stream.header
    found_hz = rate_of(first_of(blocks())) if may_have_rate(header) else None
    if found_hz is not None:
        header = replace(header, rate=found_hz)
    is_ordered = not order_error(header, own, own.count)
    changes = stream.rate_changes if is_ordered else ()
    parts = _parts(header, changes)
    pace = bend = None
    if header.is_regular and not header.has_exact_stamps and is_ordered:
        pace, bend = _on_lines(stream, blocks, parts, has_one_clock=not clock.resets)
    stray = () if pace is None else pace.stray
    part_error = ""
    if not clock.resets:
        part_error = off_in_part(header, offsets, (own.first, own.last), stream.stamps_in_blocks)
    bounds = clock_bounds(header, offsets) if part_error else None
    course = Course.of(_within(_without(blocks(), stray), bounds))
    gaps, rate_between_gaps_hz, backward_steps, furthest_back_s = Gaps(), None, 0, 0.0
    if pace is not None:
        gaps, rate_between_gaps_hz = _gaps_of(pace), 1.0 / pace.period_s
        backward_steps, furthest_back_s = pace.odd_steps_back, pace.furthest_back_s
    elif is_ordered:
        given = _cut(blocks(), [begin for begin, _ in parts])
        for (_, part), some in zip(parts, given, strict=True):
            gaps = joined(gaps, find_gaps(some, part))
        rate_between_gaps_hz = _rate_between_gaps(course, gaps, header)
        backward_steps, furthest_back_s = course.back, course.furthest_back_s
    between = [
        Gap(each.stamp_s - each.step_s, each.step_s, round(each.step_s * each.after_hz) - 1)
        for each in changes
        if each.step_s > _longest_at(each, header, pace)
    ]
    if between:
        gaps = _listed(gaps, np.array([each.length_s for each in between]), between)
    held = stream.sample_count
    return Figures(
        first=course.first if course.count else None,
        last=course.last if course.count else None,
        backward_steps=backward_steps,
        bad_stamps=held - own.count,
        rate_hz=_rate(course),
        rate_between_gaps_hz=rate_between_gaps_hz,
        gaps=gaps,
        offsets=clock,
        nan_shares=tuple(float(share) for share in stream.nan_counts / max(1, held)),
        clock_error=clock_error(header, offsets, own, own.count),
        pace=pace,
        found_hz=found_hz,
        furthest_back_s=furthest_back_s,
        part_error=part_error,
        rate_changes=changes,
        bend=bend,
    )


def _on_lines(
    stream: RecordedStream,
    blocks: Callable[[], Iterable[NDArray[np.float64]]],
    parts: Sequence[tuple[int, RecordedHeader]],
    *,
    has_one_clock: bool,
) -> tuple[Pace | None, Bend | None]:
    """Judge timestamps by a line in each part; return their pace, and where they are off most."""
    given = _cut(blocks(), [begin for begin, _ in parts])
    cuts = [cuts_of(some, part) for (_, part), some in zip(parts, given, strict=True)]
    paces = {begin: each.pace for (begin, _), each in zip(parts, cuts, strict=True) if each}
    pace = _joined_paces(paces, stream.sample_count)
    if not has_one_clock:
        return pace, None
    given = _cut(blocks(), [begin for begin, _ in parts])
    bends = [_bend(some, each) for some, each in zip(given, cuts, strict=True)]
    return pace, max(filter(None, bends), default=None)


def _parts(
    header: RecordedHeader, changes: Sequence[RateChange]
) -> list[tuple[int, RecordedHeader]]:
    """Return the start of each part with a constant rate, and the header with that rate."""
    if not changes:
        return [(0, header)]
    rates_hz = [changes[0].before_hz, *(each.after_hz for each in changes)]
    begins = [0, *(each.at for each in changes)]
    return [
        (begin, replace(header, rate=rate_hz))
        for begin, rate_hz in zip(begins, rates_hz, strict=True)
    ]


def _bend(blocks: Iterable[NDArray[np.float64]], cuts: Cuts | None) -> Bend | None:
    """Return where timestamps are furthest from the lines of their runs.

    Parameters
    ----------
    blocks
        Of a part with one rate.
    """
    pace = None if cuts is None else cuts.pace
    if cuts is None or pace is None or pace.standstills:
        return None
    worst, early_s = Bend(0.0, 0.0), 0.0
    least_s = max(_LEAST_BEND_S, 1.5 * pace.period_s, 3 * pace.moves_s)
    begins = [0, *cuts.numbers]
    for run, stamps in enumerate(_cut(_without_values(blocks, pace.stray), begins)):
        done = 0
        for block in stamps:
            count = len(block) // pace.window * pace.window
            line = cuts.times(run, done, count)
            done += len(block)
            if line is None or not count:
                continue
            # What came late is above the line, and at least one sample of a window is on it.
            rest_s = np.nan_to_num((block[:count] - line).reshape(-1, pace.window), nan=np.inf)
            lowest_s = rest_s.min(axis=1)
            lowest_s = np.where(np.isfinite(lowest_s), lowest_s, 0.0)
            at = int(np.argmax(np.abs(lowest_s)))
            worst = max(worst, Bend(float(np.abs(lowest_s[at])), float(block[at * pace.window])))
            early_s = max(early_s, float(-lowest_s.min()))
    # Samples that were held up are all above it for a while, but none comes before its time.
    return worst if early_s > least_s else None


def _longest_at(change: RateChange, header: RecordedHeader, pace: Pace | None) -> float:
    """Return the largest step at a change of the rate without a gap."""
    slow = replace(header, rate=min(change.before_hz, change.after_hz))
    late_s = 0.0 if pace is None else pace.burst / slow.rate + 3 * pace.spread_s
    return longest_step_s(slow) + late_s


def _cut(
    blocks: Iterable[NDArray[np.float64]], begins: Sequence[int]
) -> Iterator[Iterator[NDArray[np.float64]]]:
    """Yield the blocks of each part; use one completely before the next."""
    waiting, left = iter(blocks), list[NDArray[np.float64]]()

    def of(count: float) -> Iterator[NDArray[np.float64]]:
        while count > 0:
            stamps = left.pop() if left else next(waiting, None)
            if stamps is None:
                return
            if len(stamps) > count:
                left.append(stamps[int(count) :])
                stamps = stamps[: int(count)]
            count -= len(stamps)
            yield stamps

    for begin, end in pairwise([*begins, math.inf]):
        yield of(end - begin)


def _joined_paces(paces: Mapping[int, Pace | None], count: int) -> Pace | None:
    """Return the pace of the longest part, with the anomalies of all parts by sample number."""
    found = {begin: pace for begin, pace in paces.items() if pace is not None}
    if len(found) < 2:
        return next(iter(found.values()), None)
    lengths = {begin: end - begin for begin, end in pairwise([*found, count])}
    every = found.items()
    return replace(
        found[max(lengths, key=lengths.__getitem__)],
        overlap_s=max(pace.overlap_s for _, pace in every),
        holes=tuple(replace(e, at=b + e.at) for b, pace in every for e in pace.holes),
        turns=tuple(b + each for b, pace in every for each in pace.turns),
        odd_steps=tuple(b + each for b, pace in every for each in pace.odd_steps),
        stray=tuple(b + each for b, pace in every for each in pace.stray),
        standstills=tuple(replace(e, at=b + e.at) for b, pace in every for e in pace.standstills),
        ends_astray=list(found.values())[-1].ends_astray,
        furthest_back_s=max(pace.furthest_back_s for _, pace in every),
        late_first=found[min(found)].late_first,
        late_first_s=found[min(found)].late_first_s,
    )


def first_of(blocks: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return enough of the first timestamps to determine the rate."""
    parts: list[NDArray[np.float64]] = []
    count = 0
    for stamps in blocks:
        parts.append(stamps)
        count += len(stamps)
        if count >= FIRST:
            break
    return np.concatenate([np.empty(0), *parts])


def _without(
    blocks: Iterable[NDArray[np.float64]], stray: Sequence[int]
) -> Iterator[NDArray[np.float64]]:
    places = np.array(stray, np.int64)
    done = 0
    for stamps in blocks:
        here = places[(places >= done) & (places < done + len(stamps))] - done
        done += len(stamps)
        yield np.delete(stamps, here) if len(here) else stamps


def _without_values(
    blocks: Iterable[NDArray[np.float64]], places: Sequence[int]
) -> Iterator[NDArray[np.float64]]:
    """Yield the timestamps with NaN at some places."""
    done = 0
    for stamps in blocks:
        here = [at - done for at in places if done <= at < done + len(stamps)]
        done += len(stamps)
        if here:
            stamps = stamps.copy()  # noqa: PLW2901 - they may be those of the file
            stamps[here] = np.nan
        yield stamps


def _within(
    blocks: Iterable[NDArray[np.float64]], bounds: tuple[float, float] | None
) -> Iterator[NDArray[np.float64]]:
    for stamps in blocks:
        yield stamps if bounds is None else stamps[is_between(stamps, bounds)]


def is_between(stamps: NDArray[np.float64], bounds: tuple[float, float]) -> NDArray[np.bool_]:
    """Return which stamps are in a range; NaN and infinity are not."""
    return (stamps >= bounds[0]) & (stamps <= bounds[1])


@dataclass(slots=True)
class Course:
    """The order of the finite timestamps of a stream."""

    count: int = 0
    # first, last: the earliest and the latest.
    first: float = math.inf
    last: float = -math.inf
    # back, ahead, far_back: numbers of steps back, forward, and back by more than `STEP_BACK_S`.
    back: int = 0
    ahead: int = 0
    far_back: int = 0
    furthest_back_s: float = 0.0  # Largest step back.

    @classmethod
    def of(cls, blocks: Iterable[NDArray[np.float64]]) -> Course:
        """Return the course of timestamps given in blocks, in the order of the file."""
        course = cls()
        for stamps in _following(blocks):
            steps = np.diff(stamps)
            course.count += len(steps) if course.count else len(stamps)
            course.first = min(course.first, float(stamps.min()))
            course.last = max(course.last, float(stamps.max()))
            course.back += int(np.count_nonzero(steps < 0))
            course.ahead += int(np.count_nonzero(steps > 0))
            course.far_back += int(np.count_nonzero(steps < -STEP_BACK_S))
            course.furthest_back_s = max(course.furthest_back_s, -float(steps.min(initial=0.0)))
        return course


def _following(
    blocks: Iterable[NDArray[np.float64]], *, is_alone: bool = False
) -> Iterator[NDArray[np.float64]]:
    """Yield the finite timestamps of each block, with the last one before it unless alone."""
    before = np.empty(0)
    for block in blocks:
        finite = block[np.isfinite(block)]
        if len(finite):
            yield np.concatenate([before, finite])
            before = finite[-1:] if not is_alone else before


def may_have_rate(header: RecordedHeader) -> bool:
    """Whether a stream whose header names no rate may be a signal.

    Our own headers are right, and intervals between beats look like a signal because they are even.
    """
    is_signal = not header.is_markers and signal_type(header.content_type) != ContentType.RR
    return is_signal and not header.is_regular and not header.is_ours


def cuts_of(
    blocks: Iterable[NDArray[np.float64]], header: RecordedHeader, section: int = SECTION
) -> Cuts | None:
    """Find where runs begin in a regular stream whose single timestamps are inexact.

    Parameters
    ----------
    blocks
        Times of its samples in s; only read if the timestamps are inexact.
    section
        Largest number of samples analysed together.

    Returns
    -------
    Cuts or None
        None if the timestamps are exact, so single steps are enough; see `longest_step_s`. Also
        if the stream is irregular, which has no gaps.
    """
    if header.has_exact_stamps or not header.is_regular:
        return None
    cuts = Cuts(header.rate, min(section, section_of(header.rate)))
    for times in blocks:
        cuts.take(times)
    cuts.end()
    return cuts


def _gaps_of(pace: Pace) -> Gaps:
    holes = [Gap(each.after_s, each.length_s, each.lost) for each in pace.holes]
    return _listed(Gaps(), np.array([each.length_s for each in holes]), holes)


def _listed(gaps: Gaps, lengths_s: NDArray[np.float64], more: Sequence[Gap]) -> Gaps:
    """Return the gaps with later ones added; only the longest stay listed."""
    listed = [*gaps.listed, *more]
    lengths_s = np.concatenate([[each.length_s for each in gaps.listed], lengths_s])
    longest: list[int] = sorted(np.argsort(-lengths_s, kind="stable")[:MOST_GAPS_LISTED].tolist())
    return Gaps(
        gaps.count + len(more),
        gaps.lost + sum(each.lost for each in more),
        gaps.total_s + sum(each.length_s for each in more),
        tuple(listed[at] for at in longest),
    )


def joined(gaps: Gaps, later: Gaps) -> Gaps:
    """Combine the gaps of two consecutive parts of a stream."""
    both = _listed(gaps, np.array([each.length_s for each in later.listed]), later.listed)
    return replace(
        both,
        count=gaps.count + later.count,
        lost=gaps.lost + later.lost,
        total_s=gaps.total_s + later.total_s,
    )


def longest_step_s(header: RecordedHeader) -> float:
    """Return the largest step between timestamps without a gap; infinite if irregular.

    Timestamps are exact in our own streams and where the header says that samples can be missing;
    elsewhere they may jitter.
    """
    if not header.is_regular:
        return math.inf
    return max(GAP_PERIODS / header.rate, 0.0 if header.has_exact_stamps else FOREIGN_JITTER_S)


def find_gaps(blocks: Iterable[NDArray[np.float64]], header: RecordedHeader) -> Gaps:
    """Find the gaps of a regular stream.

    Parameters
    ----------
    blocks
        Timestamps in the order of the file.
    """
    gaps = Gaps()
    if not header.is_regular:
        return gaps
    for stamps in _following(blocks):
        steps = np.diff(stamps)
        places = np.flatnonzero(steps > longest_step_s(header))
        lengths = steps[places]
        lost = np.rint(np.minimum(lengths * header.rate, MOST_LOST)).astype(np.int64) - 1
        told = zip(stamps[places].tolist(), lengths.tolist(), lost.tolist(), strict=True)
        if len(places):
            gaps = _listed(gaps, lengths, [Gap(*each) for each in told])
    return gaps


def _rate(course: Course) -> float | None:
    span_s = course.last - course.first if course.count else 0.0
    return (course.count - 1) / span_s if span_s > _NO_TIME_S else None


def _rate_between_gaps(course: Course, gaps: Gaps, header: RecordedHeader) -> float | None:
    if not header.is_regular or course.count < 2:
        return None
    time_s = course.last - course.first - gaps.total_s
    steps = course.count - 1 - gaps.count
    return steps / time_s if time_s > _NO_TIME_S and steps > 0 else None


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
    course: Course,
    sample_count: int,
) -> str:
    """Return why timestamps are not on the LSL clock; empty if they are.

    Every clock offset contains the stream's own LSL time, and the header contains the time at
    which the outlet was created; the timestamps must be consistent with both.

    Parameters
    ----------
    course
        Of its timestamps; those of first and last sample of each chunk are enough.
    """
    why = order_error(header, course, sample_count)
    if why or not course.count:
        return why
    first, last = course.first, course.last
    unix = " (they are unix time)" if _UNIX_S[0] < first < _UNIX_S[1] else ""
    # For an outlet that has just closed, LabRecorder writes a clock time of 0.
    times = [time for time, _ in offsets if time and is_reading(time)]
    if times:
        # The state of a device may have been measured long before the recording.
        early_s = 0.0 if header.may_be_older else min(times) - last
        error_s = max(first - max(times), early_s)
        if error_s > MAX_STAMP_ERROR_S:
            return f"its timestamps are {seconds_text(error_s)} away from the LSL clock{unix}"
        return ""
    since = header.created_at if math.isfinite(header.created_at) else 0.0
    if last < since - MAX_STAMP_ERROR_S:
        return f"its timestamps are {seconds_text(since - last)} older than the stream itself"
    if unix or first - since > MAX_UPTIME_S:
        away = seconds_text(first - since)
        return f"its timestamps are {away} away from the creation of the stream{unix}"
    return ""


def clock_bounds(
    header: RecordedHeader, offsets: Sequence[tuple[float, float]]
) -> tuple[float, float]:
    """Return the limits, in s, of stamps that can be on the LSL clock of a stream's computer."""
    times = [time for time, _ in offsets if time and is_reading(time)]
    if times:
        low_s = -math.inf if header.may_be_older else min(times) - FAR_OFF_S
        return low_s, max(times) + FAR_OFF_S
    since = header.created_at if math.isfinite(header.created_at) else 0.0
    return -math.inf, since + MAX_UPTIME_S


def off_in_part(
    header: RecordedHeader,
    offsets: Sequence[tuple[float, float]],
    span: tuple[float, float],
    blocks: Callable[[], Iterable[NDArray[np.float64]]],
) -> str:
    """Return a sentence on the stamps that are not on the LSL clock; empty if none or all are.

    Parameters
    ----------
    span
        Its earliest and latest timestamp, in s.
    blocks
        Returns all timestamps.
    """
    low, high = clock_bounds(header, offsets)
    if low <= span[0] and span[1] <= high:
        return ""
    count = off = 0
    away_s, unix = 0.0, ""
    for stamps in _following(blocks(), is_alone=True):
        far = stamps[~is_between(stamps, (low, high))]
        count, off = count + len(stamps), off + len(far)
        if len(far) and not away_s:
            first = float(far[0])
            away_s = max(low - first, first - high) + FAR_OFF_S
            unix = " (they are unix time)" if _UNIX_S[0] < first < _UNIX_S[1] else ""
    # Single ones of a regular stream are far from their neighbours, and told as such.
    if off == count or off <= (FEW_ASTRAY if header.is_regular else 0):
        return ""
    away = seconds_text(away_s)
    return f"{off} of its {count} stamps are about {away} away from the LSL clock{unix}"


def order_error(header: RecordedHeader, course: Course, sample_count: int) -> str:
    """Return why stamps of a regular stream are not times of measurement; empty if they are.

    Parameters
    ----------
    course, sample_count
        See `clock_error`.
    """
    if not header.is_regular or sample_count < max(FEWEST, header.rate):
        return ""
    steps = course.count - 1
    if course.last - course.first < _NO_TIME_S:
        return "its stamps are all the same" if steps > 0 else ""
    # The ends of a single chunk do not tell what is between them.
    if course.back > course.ahead and steps > 1:
        return "its stamps decrease from sample to sample"
    # Stamps of a clock that was set step back now and then, those of no clock all the time.
    if course.far_back > max(3, steps / 8):
        return "its timestamps are in no order"
    return ""


def seconds_text(seconds: float, digits: int = 0) -> str:
    """Format a time in seconds; one from a damaged stamp is shortened from up to 300 digits."""
    return f"{seconds:.{digits}f} s" if abs(seconds) <= READING_LIMIT_S else f"{seconds:.3g} s"
