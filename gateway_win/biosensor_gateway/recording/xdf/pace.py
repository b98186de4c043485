"""Analyses inexact timestamps of another program's regular stream with a line fit.

Such programs often use the arrival time of a sample as its timestamp, so that single steps are
meaningless. A timestamp is the time of measurement plus a delay that is never negative, so over
many samples the earliest timestamps lie on a line over the sample number. Samples are missing
where that line jumps forward permanently, by more than it moves elsewhere.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_LOST = 1_000_000_000
"""Limit of the estimate, for timestamps that jump to another clock."""
STEP_BACK_S = 1.0
"""Larger steps back mean another clock, or a clock that was set."""
FEW_ASTRAY = 3
LONGEST_PAUSE_S = 366 * 86400.0
"""No recording is longer, so a step ahead by more is to another clock, and no loss."""
NO_PAUSE_S = 3600.0
"""A longer pause followed by only a few samples is not plausible."""
_FEWEST_FOR_RATE = 200
# Fewer samples are too few to fit a line.
FEWEST = 16
_WINDOW_S, _LONGEST_WINDOW_S = 1.0, 16.0
# Of this many bursts, at least one has a small delay.
_BURSTS_IN_WINDOW = 8
# Fewer windows are too few to estimate how far the line moves without gaps.
_FEWEST_WINDOWS = 10
# Timestamps within 0.1 periods count as equal; from 0.3 of the steps on, not by chance.
_AT_ONCE, _NOT_BY_CHANCE = 0.1, 0.3
# Of exact timestamps, this many of the steps that are not one period are whole ones, within this
# fraction, up to so many. At least so many percent of the samples come one by one.
_NEARLY_ALL, _WHOLE, _FEW_PERIODS, _NOT_LOST = 0.9, 0.1, 10, 20
_MANY = 1 << 14
# A header's rate that deviates by a larger fraction is wrong.
_NOMINAL_HOLDS = 0.05
_FAR_OFF, _OTHER_RATE = 1.5, 5.0
_SHORTEST_S = 1e-9
SECTION = 1 << 20
# Sections have this length, so that clocks do not drift within one, but at least so many samples.
_SECTION_S, _LEAST_SECTION = 600.0, 1 << 16
# Of stamps of a damaged file, sums and squares would overflow.
_FARTHEST_S = 1e150
# Moves beyond 4 times the 95th percentile are not by chance, even in a million moves.
_USUAL, _UNUSUAL = 95, 4


@dataclass(frozen=True, slots=True)
class Hole:
    """A gap: a place where samples are missing."""

    at: int  # Index of the first sample after it.
    length_s: float  # Time between the samples on either side, according to the line.
    lost: int  # Estimated number of lost samples.
    after_s: float = float("nan")  # Timestamp of the last sample before it.


@dataclass(frozen=True, slots=True)
class Standstill:
    """Samples with one timestamp, or nearly, because the clock of their sender stood still."""

    # at, count: index of the first of them, and their number.
    at: int
    count: int
    stamp_s: float  # Timestamp of the first.


@dataclass(frozen=True, slots=True)
class Pace:
    """How the timestamps of a stream deviate from a line over the sample number."""

    period_s: float  # Sample period, from the slope of the line.
    burst: int  # Number of samples that share a timestamp, or nearly; 1 where each has its own.
    spread_s: float  # Usual maximum by which timestamps are later than the line.
    moves_s: float  # How far the line moves without a gap.
    overlap_s: float  # Largest step back between timestamps that this explains.
    holes: tuple[Hole, ...]
    # Indexes of the samples at which timestamps step back by more than `STEP_BACK_S`, or the line
    # drops permanently.
    turns: tuple[int, ...]
    # Indexes of the samples at which a timestamp steps back by more than bursts and jitter explain.
    odd_steps: tuple[int, ...]
    # Indexes of outliers: samples with timestamps far from those before and after.
    stray: tuple[int, ...]
    ends_astray: bool = False
    """Whether the last sample is an outlier by more than `NO_PAUSE_S`."""
    window: int = FEWEST
    """Number of samples needed to see the line."""
    furthest_back_s: float = 0.0
    """Largest of the odd steps back."""
    late_first: int = 0
    """Number of samples at the start that came late, so that the next ones step back."""
    late_first_s: float = 0.0
    """By how much they are later than the line, at most."""
    standstills: tuple[Standstill, ...] = ()

    @property
    def odd_steps_back(self) -> int:
        """How often a timestamp steps back by more than bursts and jitter explain."""
        return len(self.odd_steps)

    @property
    def cuts(self) -> tuple[int, ...]:
        """Indexes of the samples at which a run begins, except the first run."""
        return tuple(sorted({*(each.at for each in self.holes), *self.turns}))


def find_pace(stamps: Array, nominal_hz: float) -> Pace:
    """Find the line, bursts and gaps.

    Parameters
    ----------
    stamps : ndarray of float64, shape (n_samples,)
        In the order of the file, in s; at least two are finite.
    nominal_hz
        Nominal rate in the header; above 0.
    """
    stamps = _bounded(stamps)
    found = _found(stamps, nominal_hz)
    # By a rate of the header that is not the stream's, all samples would be one burst, or all late.
    is_other = not 1 / _OTHER_RATE < found.period_s * nominal_hz < _OTHER_RATE
    is_rate = is_other and _SHORTEST_S < found.period_s < LONGEST_PAUSE_S
    return _found(stamps, 1.0 / found.period_s) if is_rate else found


def _bounded(stamps: Array) -> Array:
    is_far = np.isfinite(stamps) & (np.abs(stamps) > _FARTHEST_S)
    return np.where(is_far, np.sign(stamps) * _FARTHEST_S, stamps) if is_far.any() else stamps


def _found(stamps: Array, nominal_hz: float) -> Pace:
    given = stamps
    is_number = np.isfinite(stamps)
    is_stray = is_number & _stray(_filled(stamps, is_number), 1.0 / nominal_hz)
    stamps = _filled(stamps, is_number & ~is_stray)
    steps = np.diff(stamps)
    exact_s = _exact_period_s(steps, 1.0 / nominal_hz)
    lost = None if exact_s is None else np.clip(np.rint(steps / exact_s) - 1, 0, MOST_LOST)
    # Of exact timestamps, each gap is known, so that they are looked at as if there were none.
    whole = stamps if lost is None else stamps - exact_s * np.concatenate([[0.0], np.cumsum(lost)])
    window, period_s = _window_and_period(whole, np.diff(whole), 1.0 / nominal_hz)
    turns = _turns(whole - period_s * np.arange(len(whole)), np.diff(whole), window, period_s)
    rests = _rests(whole, turns, period_s)
    spread_s, moves_s = _spread(rests, window, period_s)
    falls = [
        begin + at
        for begin, rest in zip([0, *turns], rests, strict=True)
        for at in _falls(rest, max(period_s / 2, _UNUSUAL * spread_s), window, period_s)
    ]
    if falls:
        turns = sorted([*turns, *falls])
        rests = _rests(whole, turns, period_s)
        spread_s, moves_s = _spread(rests, window, period_s)
    jumps = (
        _jumps_of(rests, turns, period_s, (spread_s, moves_s), window)
        if lost is None
        else [(at + 1, float(steps[at]) - period_s) for at in np.flatnonzero(lost).tolist()]
    )
    holes = [
        Hole(at, jump_s + period_s, _lost(jump_s, period_s), float(given[at - 1]))
        for at, jump_s in jumps
    ]
    turns = sorted([*turns, *(each.at for each in holes if each.length_s > LONGEST_PAUSE_S)])
    holes = [each for each in holes if each.length_s <= LONGEST_PAUSE_S]
    cuts = sorted({0, *(each.at for each in holes), *turns, len(stamps)})
    lines = [_Line.through(stamps, *ends, period_s, window) for ends in pairwise(cuts)]
    usual_s = max(period_s, _UNUSUAL * spread_s)
    usual = -steps[(steps < 0) & (-steps <= usual_s)]
    odd_steps = (np.flatnonzero(steps < -usual_s) + 1).tolist()
    late_first = max((at for at in odd_steps if at < min([window, *cuts[1:]])), default=0)
    odd_steps = [at for at in odd_steps if at > late_first]
    odd = -steps[np.array(odd_steps, np.int64) - 1]
    return Pace(
        _slope_s(lines, period_s),
        _burst(steps, period_s),
        spread_s,
        moves_s,
        float(usual.max()) if len(usual) else 0.0,
        tuple(holes),
        tuple(turns),
        tuple(odd_steps),
        tuple(np.flatnonzero(is_stray).tolist()),
        bool(is_stray[-1]) and abs(float(given[-1]) - stamps[-1]) > NO_PAUSE_S,
        window,
        float(odd.max(initial=0.0)),
        late_first,
        float(np.max(stamps[:late_first] - lines[0].times(0, late_first, period_s), initial=0.0)),
    )


def _exact_period_s(steps: Array, nominal_s: float) -> float | None:
    """Return the period if a step is one period, or by a gap some whole ones; None if not.

    Then each missing sample shows, also if so many are missing, here and there, that a line through
    all timestamps has another slope.
    """
    some = steps[:: 1 + len(steps) // _MANY]
    least_s = float(np.percentile(some, _NOT_LOST)) if len(some) else 0.0
    if not _SHORTEST_S < least_s < LONGEST_PAUSE_S:
        return None
    single = steps[np.abs(steps / least_s - 1) < _WHOLE]
    # Between a few different steps, the percentile is none of them.
    period_s = float(np.median(single)) if len(single) else math.inf
    if abs(period_s / nominal_s - 1) > _NOMINAL_HOLDS:
        return None
    # How long a pause is need not be a number of periods. Where packets come late, the step after
    # the one that is too long is too short.
    odd = steps[(np.abs(steps / period_s - 1) >= _WHOLE) & (steps < _FEW_PERIODS * period_s)]
    periods = np.rint(odd / period_s)
    is_gap = (np.abs(odd / period_s - periods) < _WHOLE) & (periods > 1)
    return period_s if np.count_nonzero(is_gap) >= _NEARLY_ALL * len(odd) else None


def _lost(jump_s: float, period_s: float) -> int:
    return round(min(jump_s / period_s, MOST_LOST))


def section_of(rate_hz: float) -> int:
    """Return how many samples of a stream are analysed together, at most `SECTION`."""
    return int(min(max(_SECTION_S * rate_hz, _LEAST_SECTION), SECTION))


def rate_of(stamps: Array) -> float | None:
    """Return the rate of a stream without one in its header; None if its samples are uneven.

    However late single stamps are, a number of samples takes as long everywhere in an even stream.
    Where each step is another one, as from beat to beat, it varies the more, the more samples.

    Parameters
    ----------
    stamps : ndarray of float64, shape (n_samples,)
        In the order of the file, in s.
    """
    stamps = stamps[np.isfinite(stamps)]
    if len(stamps) < _FEWEST_FOR_RATE:
        return None
    steps = np.diff(stamps)
    # A pause is as long as it likes.
    longest_s = 3 * float(np.percentile(np.abs(steps), 99.5))
    steps = np.clip(steps, -longest_s, longest_s)
    line = np.concatenate([[0.0], np.cumsum(steps)])
    few = max(4, len(line) // 100)
    many = 8 * few
    spans_s = line[many:] - line[:-many]
    period_s = float(np.median(spans_s)) / many
    if period_s <= 0 or np.count_nonzero(steps < 0) > len(steps) / 3:
        return None
    most_s = max(1.6 * _range(line[few:] - line[:-few], 10), 1.5 * _range(steps, 0.1))
    if _range(spans_s, 10) > most_s + _AT_ONCE * period_s:
        return None
    return 1.0 / find_pace(stamps, 1.0 / period_s).period_s


def _range(values: Array, percent: float) -> float:
    low, high = np.percentile(values, (percent, 100 - percent))
    return float(high - low)


class Cuts:
    """Finds where runs begin in a stream that is read in blocks.

    Parameters
    ----------
    nominal_hz
        Nominal rate in the header; above 0.
    section
        Number of samples analysed together, so that memory use stays constant.
    """

    def __init__(self, nominal_hz: float, section: int = SECTION) -> None:
        self._nominal_hz, self._section = nominal_hz, section
        self.pace: Pace | None = None  # Of all sections so far; None before there is one.
        # Indexes of the samples at which a run begins, except the first run, as found so far.
        self.numbers: list[int] = []
        # holes, stray: as found so far; see `Pace`.
        self.holes: list[Hole] = []
        self.stray: list[int] = []
        self._odd_steps: list[int] = []
        self._standstills: list[Standstill] = []
        # While the clock stands still: its timestamp, the last one in place of it, and the period.
        self._standing: tuple[float, float, float] | None = None
        # By the number of the run.
        self._lines: dict[int, _Line] = {}
        self._blocks: list[Array] = []
        self._begin = self._held = self._settled = 0

    @property
    def period_s(self) -> float:
        """Sample period; nominal before there is a section."""
        return 1.0 / self._nominal_hz if self.pace is None else self.pace.period_s

    def times(self, run: int, first: int, count: int) -> Array | None:
        """Return the times on the line of a run, from its sample `first` on; None if unknown."""
        line = self._lines.get(run)
        begin = first + (self.numbers[run - 1] if run else 0)
        return None if line is None else line.times(begin, count, self.period_s)

    def take(self, times: Array) -> None:
        """Add the times of the next samples, shape (n_samples,)."""
        times = self._moved_on(_bounded(times))
        self._blocks.append(times)
        self._held += len(times)
        if self._held >= self._section:
            # Near the end of a section too few samples follow to detect a jump, so half is kept.
            section = self._moving(np.concatenate(self._blocks))
            self._look(section, len(section) - self._section // 4)
            kept = section[-self._section // 2 :].copy()
            self._begin += self._held - len(kept)
            self._blocks, self._held = [kept], len(kept)

    def end(self) -> None:
        """Analyse the remaining samples; none follow."""
        if self._held:
            section = self._moving(np.concatenate(self._blocks))
            self._look(section, len(section))

    def _moving(self, section: Array) -> Array:
        """Return a section as if the clock had not stood still in it."""
        section, period_s, found = _moving(section, 1.0 / self._nominal_hz)
        self._standstills += [replace(each, at=self._begin + each.at) for each in found]
        if found and found[-1].at + found[-1].count == len(section):
            self._standing = found[-1].stamp_s, float(section[-1]), period_s
        return section

    def _moved_on(self, times: Array) -> Array:
        """Return the next times; while the clock stands still, they continue by the period."""
        if self._standing is None:
            return times
        stamp_s, last_s, period_s = self._standing
        is_moving = ~(np.abs(times - stamp_s) <= period_s)
        count = int(np.argmax(is_moving)) if is_moving.any() else len(times)
        filled: Array = last_s + period_s * np.arange(1, count + 1, dtype=np.float64)
        last = self._standstills[-1]
        self._standstills[-1] = replace(last, count=last.count + count)
        if count < len(times):
            self._standing = None
        elif count:
            self._standing = stamp_s, float(filled[-1]), period_s
        return np.concatenate([filled, times[count:]])

    def _look(self, section: Array, settled: int) -> None:
        """Analyse a section; later ones add no information before index `settled`."""
        if np.count_nonzero(np.isfinite(section)) < 2:
            return
        pace = find_pace(section, self._nominal_hz)
        # Samples near the border are analysed twice.
        last = self.numbers[-1] if self.numbers else 0
        self.numbers += [each for at in pace.cuts if (each := self._begin + at) > last]
        self.holes += [
            replace(hole, at=at) for hole in pace.holes if (at := self._begin + hole.at) > last
        ]
        # Where a section begins is not where the stream does.
        last = self.stray[-1] if self.stray else self._begin + FEW_ASTRAY - 1 if self._begin else -1
        self.stray += [each for at in pace.stray if (each := self._begin + at) > last]
        self._settle(section, pace, settled)
        pace = replace(pace, standstills=tuple(self._standstills))
        self.pace = pace if not self._begin else self._joined(pace)

    def _settle(self, section: Array, pace: Pace, settled: int) -> None:
        begin, end = max(0, self._settled - self._begin), settled
        self._odd_steps += [self._begin + at for at in pace.odd_steps if begin <= at < end]
        is_good = np.isfinite(section)
        is_good[list(pace.stray)] = False
        stamps = _filled(section, is_good)
        cuts = [at for each in self.numbers if begin < (at := each - self._begin) < end]
        for first, behind in pairwise([begin, *cuts, end]):
            line = _Line.through(stamps, first, behind, pace.period_s, pace.window)
            line = replace(line, number=self._begin + line.number)
            run = bisect_right(self.numbers, self._begin + first)
            known = self._lines.get(run)
            self._lines[run] = line if known is None else known.joined(line)
        self._settled = self._begin + end

    def _joined(self, last: Pace) -> Pace:
        earlier = last if self.pace is None else self.pace
        gaps = {each.at for each in self.holes}
        return Pace(
            _slope_s(self._lines.values(), last.period_s),
            earlier.burst,
            max(earlier.spread_s, last.spread_s),
            max(earlier.moves_s, last.moves_s),
            max(earlier.overlap_s, last.overlap_s),
            tuple(self.holes),
            tuple(each for each in self.numbers if each not in gaps),
            tuple(self._odd_steps),
            tuple(self.stray),
            last.ends_astray,
            last.window,
            max(earlier.furthest_back_s, last.furthest_back_s),
            earlier.late_first,
            earlier.late_first_s,
            last.standstills,
        )


def stray_text(count: int) -> str:
    """Return the sentence about outliers."""
    stamps = "1 stamp is" if count == 1 else f"{count} stamps are"
    return f"{stamps} far from those before and after"


def without_stray(stamps: Array, nominal_s: float) -> dict[int, float]:
    """Return, by index, the timestamps in place of outliers: those between their neighbours.

    Parameters
    ----------
    stamps : ndarray of float64, shape (n_samples,)
        In the order of the file, in s; NaN or infinite where a sample has none.
    nominal_s
        Nominal sample period.
    """
    is_number = np.isfinite(stamps)
    if np.count_nonzero(is_number) < 2:
        return {}
    is_stray = is_number & _stray(_filled(stamps, is_number), nominal_s)
    filled = _filled(stamps, is_number & ~is_stray)
    return {at: float(filled[at]) for at in np.flatnonzero(is_stray).tolist()}


def _filled(stamps: Array, is_good: NDArray[np.bool_]) -> Array:
    """Return the timestamps with bad ones replaced by interpolation."""
    if is_good.all():
        return stamps
    number = np.arange(len(stamps))
    return np.interp(number, number[is_good], stamps[is_good])


def _stray(stamps: Array, nominal_s: float) -> NDArray[np.bool_]:
    """Find timestamps that leave the line for a few samples, also at the very start and end."""
    is_stray = np.zeros(len(stamps), bool)
    steps = np.abs(np.diff(stamps))
    # Not by the header alone, which may be about seconds where the stamps are about milliseconds.
    usual_s = max(nominal_s, float(np.median(steps)) if len(steps) else 0.0)
    far = np.flatnonzero(steps > max(STEP_BACK_S, 10 * usual_s)) + 1
    for at in far.tolist():
        if is_stray[at] or is_stray[at - 1]:
            continue
        away_s = abs(stamps[at] - stamps[at - 1])
        for behind in range(at + 1, min(at + 1 + FEW_ASTRAY, len(stamps))):
            if abs(stamps[behind] - stamps[at - 1]) <= away_s / 2:
                is_stray[at:behind] = True
                break
        else:
            # An outlet that closes while it is recorded may leave garbage after its last sample.
            is_last = at + FEW_ASTRAY >= len(stamps) > 2 * FEW_ASTRAY
            if is_last and away_s > NO_PAUSE_S:
                is_stray[at:] = True
            elif at <= FEW_ASTRAY < len(stamps) // 2 and away_s > NO_PAUSE_S:
                is_stray[:at] = True
    return is_stray


def _moving(stamps: Array, nominal_s: float) -> tuple[Array, float, list[Standstill]]:
    """Continue timestamps by the period where the clock stood still.

    A burst that comes at once is stamped late, after a step as long as itself. Where a clock stands
    still, the first timestamp is right, and the step to the next one is long or never comes.
    """
    steps = np.diff(stamps)
    middle_s = float(np.nanmedian(steps)) if np.isfinite(steps).any() else 0.0
    period_s = min(nominal_s, middle_s) if middle_s > 0 else nominal_s
    is_same = np.concatenate([[False], np.abs(steps) <= _AT_ONCE * period_s, [False]])
    begins = np.flatnonzero(~is_same[:-1] & is_same[1:])
    ends = np.flatnonzero(is_same[:-1] & ~is_same[1:]) + 1
    counts = ends - begins
    usual = float(np.median(counts)) if len(counts) >= FEW_ASTRAY else 1.0
    least = max(FEWEST, 3 * usual, STEP_BACK_S / period_s)
    found: list[Standstill] = []
    for place in np.flatnonzero(counts > least).tolist():
        begin, end = int(begins[place]), int(ends[place])
        length_s = (end - begin) * period_s
        before_s = stamps[begin] - stamps[begin - 1] if begin else math.nan
        behind_s = stamps[end] - stamps[begin] if end < len(stamps) else math.nan
        # Without samples on both sides, nobody can tell.
        if before_s < length_s / 2 or (not begin and abs(behind_s) >= length_s / 2):
            found.append(Standstill(begin, end - begin, float(stamps[begin])))
    if found:
        stamps = stamps.copy()
    for each in found:
        end = each.at + each.count
        whole_s = float(stamps[end]) - each.stamp_s if end < len(stamps) else math.nan
        is_next = abs(whole_s / (each.count * period_s) - 1) < _NOMINAL_HOLDS
        step_s = whole_s / each.count if is_next else period_s
        stamps[each.at : end] = each.stamp_s + step_s * np.arange(each.count)
    return stamps, period_s, found


def _turns(rest: Array, steps: Array, window: int, period_s: float) -> list[int]:
    """Find large steps back of timestamps, caused by another clock or a clock that was set.

    What came late is above the line, and what follows is on it. Before the first packet there is
    no line: that it was late is believed if it is not much later than others are.
    """
    places = (np.flatnonzero(steps < -STEP_BACK_S) + 1).tolist()
    if not places:
        return []
    latest_s = _UNUSUAL * _spread([rest], window, period_s)[0]
    found: list[int] = []
    for at in places:
        begin = max(found[-1] if found else 0, at - window)
        before_s, behind_s = float(rest[begin:at].min()), float(rest[at : at + window].min())
        is_first = not found and at < window and -steps[at - 1] <= latest_s
        if before_s - behind_s > STEP_BACK_S / 2 and not is_first:
            found.append(at)
    return found


def _window_and_period(stamps: Array, steps: Array, nominal_s: float) -> tuple[int, float]:
    """Return the number of samples needed to see the line, and its median slope."""
    usual_s = float(np.median(steps)) if len(steps) else nominal_s
    if _is_stamped_at_once(steps, nominal_s):
        # The last sample of a burst has the smallest delay.
        marks = np.flatnonzero(steps > _AT_ONCE * nominal_s)
        pushes, lag = marks, _BURSTS_IN_WINDOW
    else:
        if usual_s > 0 and abs(usual_s / nominal_s - 1) > _NOMINAL_HOLDS:
            nominal_s = usual_s
        marks = np.arange(len(stamps))
        # After a late sample the next step is short; after a gap it is not.
        pushes, lag = np.flatnonzero(steps < usual_s / 2), 0
    several = 0.0
    if len(pushes) > 1:
        several = _BURSTS_IN_WINDOW * float(np.median(np.diff(pushes)))
    wanted = max(_WINDOW_S / nominal_s, min(several, _LONGEST_WINDOW_S / nominal_s))
    # In a short stream, several short windows are better than long ones if each has some bursts.
    most = len(steps) / (2 if several else _FEWEST_WINDOWS)
    window = max(FEWEST, int(min(wanted, most)))
    lag = lag or window
    if len(marks) < _FEWEST_WINDOWS * lag:
        # A few bursts show whether the nominal rate is far off, and no more.
        coarse_s = _slope_between(stamps, marks, len(marks) // _FEWEST_WINDOWS)
        return window, coarse_s if pushes is marks and is_far_off(
            coarse_s, nominal_s
        ) else nominal_s
    # Fewer than half of the slopes contain a gap, so the median is not affected.
    slope_s = _slope_between(stamps, marks, lag)
    is_usual = np.abs(steps - usual_s) < _NOMINAL_HOLDS * usual_s
    if lag == window and is_usual.mean() > 0.5 and abs(slope_s / usual_s - 1) > _NOMINAL_HOLDS:
        # No clock is this wrong, so there are gaps everywhere.
        return window, usual_s
    return window, slope_s if slope_s > 0 else nominal_s


def _slope_between(stamps: Array, marks: NDArray[np.int64], lag: int) -> float:
    """Return the median slope between marks `lag` marks apart; 0 if there are none."""
    if not 0 < lag < len(marks):
        return 0.0
    return float(
        np.median((stamps[marks[lag:]] - stamps[marks[:-lag]]) / (marks[lag:] - marks[:-lag]))
    )


def is_far_off(rate: float, nominal: float) -> bool:
    """Whether a rate or period differs from the nominal one by more than chance."""
    return rate > 0 and not 1 / _FAR_OFF < rate / nominal < _FAR_OFF


def _is_late(rest_steps: Array, period_s: float) -> bool:
    """Whether some samples were delayed: after a delay the next step is short."""
    return bool((rest_steps < -period_s / 2).any())


def _spread(rests: list[Array], window: int, period_s: float) -> tuple[float, float]:
    """Return the spread above the line, and how far the line moves without a gap."""
    blocks = [
        each[: len(each) // window * window].reshape(-1, window)
        for each in rests
        if len(each) >= window
    ]
    if not blocks:
        whole_s = max((float(np.ptp(each)) for each in rests), default=0.0)
        return whole_s, whole_s / _UNUSUAL
    moves = np.concatenate([np.diff(each.min(axis=1)) for each in blocks])
    spans = np.concatenate([each.max(axis=1) - each.min(axis=1) for each in blocks])
    # A gap only moves the line forward; everything else moves it both ways.
    back = -moves[moves < 0]
    moves_s = float(np.percentile(back, _USUAL)) if len(back) else 0.0
    spread_s = float(np.median(spans))
    if not any(_is_late(np.diff(each), period_s) for each in rests):
        return spread_s, moves_s
    # A few windows may underestimate how far the line moves.
    part = _UNUSUAL if len(moves) < _FEWEST_WINDOWS else _UNUSUAL**2
    return spread_s, max(moves_s, spread_s / part)


def _jumps_of(
    rests: list[Array], turns: list[int], period_s: float, usual_s: tuple[float, float], window: int
) -> list[tuple[int, float]]:
    """Find where the lines of all parts jump forward; `usual_s` is the result of `_spread`."""
    spread_s, moves_s = usual_s
    most_s = max(period_s / 2, _UNUSUAL * moves_s)
    return [
        (begin + at, jump_s)
        for begin, rest in zip([0, *turns], rests, strict=True)
        for at, jump_s in _jumps(rest, period_s, spread_s, most_s, window)
    ]


def _jumps(
    rest: Array, period_s: float, spread_s: float, most_s: float, window: int
) -> list[tuple[int, float]]:
    """Find where the line jumps forward permanently, and how far."""
    steps = np.diff(rest)
    places = np.flatnonzero(steps > period_s / 2) + 1
    lowest = _lowest(rest, window)
    jumps = lowest[places] - lowest[np.maximum(places - window, 0)]
    places = places[(jumps > most_s) | (places < window)]
    # A few samples may all be late, and one packet may be very late.
    late_s = max(most_s, _UNUSUAL * spread_s if _is_late(steps, period_s) else 0.0)
    found: dict[int, float] = {}
    bounds = [0, len(rest)]
    # The largest first: near a known gap, fewer samples remain to judge another place.
    waiting = places[np.argsort(-steps[places - 1], kind="stable")].tolist()
    while waiting:
        again: list[int] = []
        for place in waiting:
            at = bisect_left(bounds, place)
            before = rest[max(bounds[at - 1], place - window) : place]
            following = rest[place : min(bounds[at], place + window)]
            before_s = float(before.min())
            # Delayed samples arrive all at once, so as many samples later they are on the line
            # again.
            held_up = int(1.5 * (float(following.max()) - before_s) / period_s) + 1
            after_s = float(rest[place : min(bounds[at], place + max(window, held_up))].min())
            is_told = min(len(before), len(following)) >= window
            jump_s = after_s - before_s
            if jump_s <= (most_s if is_told else late_s):
                continue
            if jump_s >= 2 * steps[place - 1]:
                # Another gap is near and may be found first.
                again.append(place)
                continue
            found[place] = jump_s
            bounds.insert(at, place)
        waiting = again if len(again) < len(waiting) else []
    return sorted(found.items())


def _rests(stamps: Array, turns: list[int], period_s: float) -> list[Array]:
    """Return the distance of each part's timestamps above a line through its first one."""
    parts = [stamps[begin:end] for begin, end in pairwise([0, *turns, len(stamps)])]
    return [part - period_s * np.arange(len(part)) for part in parts]


def _falls(rest: Array, most_s: float, window: int, period_s: float) -> list[int]:
    """Find where the line drops permanently: repeated samples, or a clock set back."""
    found: list[int] = []
    steps = np.diff(rest)
    jumps = (np.flatnonzero(steps > most_s) + 1).tolist()
    for place in (np.flatnonzero(steps < -most_s) + 1).tolist():
        begin = max(found[-1] if found else 0, place - window)
        before, following = rest[begin:place], rest[place : place + window]
        is_told = min(len(before), len(following)) >= window
        # Late samples lie above the line one by one; before a drop all samples do.
        if not is_told or float(before.min()) - float(following.max()) <= most_s:
            continue
        number = bisect_left(jumps, place)
        if not (number and _was_held_up(rest, jumps[number - 1], place, window, period_s, most_s)):
            found.append(place)
    return found


def _was_held_up(
    rest: Array, jump: int, place: int, window: int, period_s: float, most_s: float
) -> bool:
    """Whether samples since a jump ahead come at once, down to the line before it."""
    line_s = float(rest[max(0, jump - window) : jump].min())
    is_at_once = rest[jump] - rest[place] > (place - jump) * period_s / 2
    return bool(is_at_once and float(rest[place : place + window].max()) > line_s - most_s)


def _lowest(values: Array, window: int) -> Array:
    """Return the minimum of a window starting at each value; shorter at the end."""
    found, length = values.copy(), 1
    while length < min(window, len(values)):
        step = min(length, window - length)
        found[:-step] = np.minimum(found[:-step], found[step:])
        length += step
    return found


@dataclass(frozen=True, slots=True)
class _Line:
    """A line through the earliest timestamps of a run, as sums for least squares."""

    count: int  # Number of timestamps that it goes through.
    # number, stamp_s: their mean index and mean timestamp.
    number: float
    stamp_s: float
    # products, squares: sums of (index - mean) * (timestamp - mean) and of (index - mean) ** 2.
    products: float
    squares: float

    @classmethod
    def through(cls, stamps: Array, begin: int, end: int, usual_s: float, window: int) -> _Line:
        """Return the line through the timestamps of a run from index `begin` to `end`."""
        number = np.arange(end - begin, dtype=np.float64)
        rest = stamps[begin:end] - usual_s * number
        lowest = _lowest(rest, window)
        earlier = np.roll(lowest, min(window, len(rest)) - 1)
        is_early = rest - np.minimum(lowest, earlier) <= usual_s
        number, rest = number[is_early], rest[is_early]
        middle, rest_s = float(number.mean()), float(rest.mean())
        number -= middle
        squares = float(number @ number)
        products = float(number @ (rest - rest_s)) + usual_s * squares
        return cls(len(number), begin + middle, rest_s + usual_s * middle, products, squares)

    def times(self, first: int, count: int, period_s: float) -> Array:
        """Return the times of `count` samples on the line, from index `first` on."""
        number = np.arange(first, first + count, dtype=np.float64)
        return self.stamp_s + period_s * (number - self.number)

    def joined(self, other: _Line) -> _Line:
        """Return the line through the timestamps of both."""
        count = self.count + other.count
        part = other.count / count
        number, stamp_s = other.number - self.number, other.stamp_s - self.stamp_s
        weight = self.count * part
        return _Line(
            count,
            self.number + number * part,
            self.stamp_s + stamp_s * part,
            self.products + other.products + weight * number * stamp_s,
            self.squares + other.squares + weight * number * number,
        )


def _slope_s(lines: Iterable[_Line], usual_s: float) -> float:
    """Return the common slope of the lines of all runs."""
    products = squares = 0.0
    for line in lines:
        products += line.products - usual_s * line.squares
        squares += line.squares
    slope_s = usual_s + products / squares if squares else usual_s
    return slope_s if slope_s > 0 else usual_s


def _is_stamped_at_once(steps: Array, period_s: float) -> bool:
    """Whether samples share a timestamp, or nearly, more often than by chance."""
    at_once = np.count_nonzero(np.abs(steps) <= _AT_ONCE * period_s)
    return bool(at_once > _NOT_BY_CHANCE * len(steps))


def _burst(steps: Array, period_s: float) -> int:
    """Return the number of samples with (nearly) the same timestamp; 1 without bursts."""
    if not _is_stamped_at_once(steps, period_s):
        return 1
    ends = np.flatnonzero(np.abs(steps) > _AT_ONCE * period_s)
    return round(float(np.median(np.diff(ends)))) if len(ends) > 1 else len(steps) + 1
