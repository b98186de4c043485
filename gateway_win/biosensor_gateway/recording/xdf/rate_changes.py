"""Finds permanent changes of a regular stream's rate, such as by new settings of its sender.

A line through all its timestamps would be seconds off, and steps that are twice as long would be
thousands of gaps. So such a stream is cut into parts of one rate each.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.xdf.header import RecordedHeader

Array = NDArray[np.float64]
Read = Callable[[int, int], Array]
"""Returns the timestamps from one index to before another, in the order of the file."""

SMALL_CHANGE = 0.05
"""A rate that differs by a smaller fraction may be that of a clock, or jitter."""
# Of neighbouring spans of a constant rate, so many percent differ by less than half of that. Where
# the longest spans differ by more, only a change of several times as much is one.
_MOST_PERCENT, _WORST, _TIMES = 70, 0.15, 3
# A smaller change, down to this fraction, must explain most of the distance from one line, which is
# at least so much in s, and a stream has at most so many.
_LEAST_SMALL, _EXPLAINED, _LEAST_AWAY_S, _MOST_SMALL = 0.01, 0.8, 0.1, 3
# Number of spans that must have the new rate, and before it the old one; one may be odd.
_SPANS = 4
_SHORTEST_S = 1.0
_NO_TIME_S = 1e-9
# Samples that were held up come all at once, at no rate.
_MOST_AT_ONCE = 10.0
# Of exact timestamps, nearly all steps are whole periods within this fraction.
_WHOLE, _NEARLY_ALL, _BY_CHANCE = 0.1, 0.9, 0.05
_MOST_POINTS = 1 << 14
MOST_CHANGES = 50
"""A stream with more changes has no rate."""


@dataclass(frozen=True, slots=True)
class RateChange:
    """A change of a stream's rate."""

    at: int  # Index of the first sample with the new rate; those with a NaN timestamp count, too.
    # stamp_s, step_s: its timestamp, and the step to it.
    stamp_s: float
    step_s: float
    before_hz: float
    after_hz: float


class _Cut(NamedTuple):
    """A change, by the number of the first span with the new period."""

    at: int
    before: float
    after: float


class Curve:
    """Some timestamps of a stream, evenly over its samples, and at most `_MOST_POINTS`."""

    def __init__(self) -> None:
        self._points = array("d")
        self._every, self._count = 1, 0

    def add(self, stamps: Array) -> None:
        """Add the next timestamps, shape (n_samples,)."""
        first = -self._count % self._every
        self._count += len(stamps)
        self._points.frombytes(np.ascontiguousarray(stamps[first :: self._every]).tobytes())
        while len(self._points) > _MOST_POINTS:
            self._points = self._points[::2]
            self._every *= 2

    def changes(self, header: RecordedHeader, read: Read) -> tuple[RateChange, ...]:
        """Return where the rate changes, in the order of the file.

        Parameters
        ----------
        read
            Gives the timestamps near such a place.
        """
        if not header.is_regular or header.is_markers or self._count < 2 * _SPANS:
            return ()
        with np.errstate(all="ignore"):
            length, periods_s, least = self._spans(SMALL_CHANGE)
            found = _without_delays(_cuts(periods_s, least), periods_s, least)
            if not found and not header.has_exact_stamps:
                length, periods_s, least = self._spans(_LEAST_SMALL)
                found = _cuts(periods_s, least)
                found = found if self._explains(found, length) else []
        changes: list[RateChange] = []
        for at, before_s, after_s in found:
            begin, end = max(0, (at - 2) * length), min(self._count, (at + 2) * length + 1)
            stamps = _filled(read(begin, end))
            place = _corner(stamps, before_s, after_s, max(_SPANS, length / 4))
            slow = stamps[place:] if after_s > before_s else stamps[:place]
            is_behind = not changes or changes[-1].at < begin + place
            if is_behind and not _is_loss(slow, min(before_s, after_s)):
                stamp_s, last_s = float(stamps[place]), float(stamps[place - 1])
                ends = stamp_s, stamp_s - last_s, 1 / before_s, 1 / after_s
                changes.append(RateChange(begin + place, *ends))
        return self._with_rates_of_short(changes, 2 * _SPANS * length, read)

    def _with_rates_of_short(
        self, changes: Sequence[RateChange], short: int, read: Read
    ) -> tuple[RateChange, ...]:
        """Return the changes with the rates from end to end of short parts that have no gaps."""
        if not changes:
            return ()
        bounds = [0, *(each.at for each in changes), self._count]
        rates_hz = [changes[0].before_hz, *(each.after_hz for each in changes)]
        for place, (begin, end) in enumerate(pairwise(bounds)):
            length_s = float(read(end - 1, end)[0] - read(begin, begin + 1)[0])
            rate_hz = (end - begin - 1) / length_s if length_s > 0 else math.nan
            if end - begin < short and abs(rate_hz / rates_hz[place] - 1) < _WORST:
                rates_hz[place] = rate_hz
        ends = zip(changes, rates_hz[:-1], rates_hz[1:], strict=True)
        return tuple(replace(e, before_hz=before, after_hz=after) for e, before, after in ends)

    def _explains(self, cuts: Sequence[_Cut], length: int) -> bool:
        """Whether lines between these cuts are much closer to the timestamps than one line is."""
        if not 0 < len(cuts) <= _MOST_SMALL:
            return False
        points = _filled(np.array(self._points))
        bounds = [0, *(each.at * length // self._every for each in cuts), len(points)]
        whole_s = _away_s(points)
        parts_s = max(_away_s(points[begin:end]) for begin, end in pairwise(bounds))
        return whole_s > _LEAST_AWAY_S and parts_s < (1 - _EXPLAINED) * whole_s

    def _spans(self, small: float) -> tuple[int, Array, float]:
        """Return the length of spans in samples, the sample period in each, and the least change.

        Spans are so long that most are alike; there is none if they never are.

        Parameters
        ----------
        small
            A change by a smaller fraction is none.
        """
        points = _filled(np.array(self._points))
        # Samples of a burst have one timestamp.
        lag = max(1, len(points) // 16)
        usual_s = float(np.median(points[lag:] - points[:-lag])) / lag
        least = max(1, math.ceil(_SHORTEST_S / usual_s)) if usual_s > _NO_TIME_S else 1
        longest = (len(points) // (2 * _SPANS * least)).bit_length()
        found, least_move = (0, np.empty(0), small), _WORST
        for count in (least << doubled for doubled in range(longest)):
            periods_s = np.diff(points[::count]) / (count * self._every)
            moves = np.abs(np.diff(np.log(periods_s)))
            # A NaN is of a period that is not positive.
            moves = np.where(np.isnan(moves), np.inf, moves)
            move = float(np.percentile(moves, _MOST_PERCENT))
            if move < least_move:
                least_move = move
                found = count * self._every, periods_s, max(small, _TIMES * move)
            if move < small / 2:
                break
        return found


def _away_s(stamps: Array) -> float:
    """Return how far a line is from timestamps, from the 5th to the 95th percentile."""
    number = np.arange(len(stamps)) - (len(stamps) - 1) / 2
    squares = float(number @ number)
    rest = stamps - (float(number @ stamps) / squares if squares else 0.0) * number
    return float(np.ptp(np.percentile(rest, (5, 95))))


def _filled(stamps: Array) -> Array:
    """Return timestamps in which those that are not numbers are interpolated."""
    is_number = np.isfinite(stamps)
    if is_number.all() or not is_number.any():
        return stamps
    place = np.arange(len(stamps))
    return np.interp(place, place[is_number], stamps[is_number])


def _cuts(periods: Array, least: float) -> list[_Cut]:
    """Return where all periods except one are longer, or shorter, than all before except one."""
    if len(periods) < 2 * _SPANS:
        return []
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(periods, _SPANS), axis=1)
    before, after = windows[:-_SPANS], windows[_SPANS:]
    is_change = (after[:, 1] > (1 + least) * before[:, -2]) & (before[:, 1] > 0)
    is_change |= (before[:, 1] > (1 + least) * after[:, -2]) & (after[:, 1] > 0)
    # The place is the one at which the periods on either side differ least from each other.
    uneven = (before[:, -1] - before[:, 0]) / before[:, -1]
    uneven += (after[:, -1] - after[:, 0]) / after[:, -1]
    places = np.flatnonzero(is_change)
    groups = np.split(places, np.flatnonzero(np.diff(places) > _SPANS) + 1) if len(places) else []
    cuts = [int(each[np.argmin(uneven[each])]) + _SPANS for each in groups]
    return _told(cuts, periods, least)


def _told(cuts: Sequence[int], periods: Array, least: float) -> list[_Cut]:
    """Return the cuts with the periods on either side, without those that are no change."""
    bounds = [0, *cuts, len(periods)]
    # The spans beside a change have some samples of either rate.
    inner = [
        (begin + (end - begin > 2), end - (end - begin > 2)) for begin, end in pairwise(bounds)
    ]
    usual = [_usual(periods[begin:end]) for begin, end in inner]
    found = [_Cut(*each) for each in zip(cuts, usual[:-1], usual[1:], strict=True)]
    kept = [
        each.at
        for each in found
        if min(each.before, each.after) > 0 and abs(math.log(each.after / each.before)) > least
    ]
    return found if len(kept) == len(found) else _told(kept, periods, least)


def _usual(periods: Array) -> float:
    """Return the mean period without those of spans with gaps."""
    middle = float(np.median(periods))
    is_usual = np.abs(periods - middle) <= middle / 4
    return float(periods[is_usual].mean()) if is_usual.any() else middle


def _without_delays(cuts: list[_Cut], periods: Array, least: float) -> list[_Cut]:
    """Return the cuts without those caused by samples that came late and together."""
    bounds = [*(each.at for each in cuts), len(periods)]
    for number, (cut, end) in enumerate(zip(cuts, bounds[1:], strict=True)):
        # Behind them, the stamps are where they would be without.
        begin = max(0, cut.at - 2)
        away = float(periods[begin:end].sum()) / cut.before - (end - begin)
        is_late = cut.after < cut.before and abs(away) < 1
        if is_late or cut.after < cut.before / _MOST_AT_ONCE:
            left = [each.at for at, each in enumerate(cuts) if at not in (number, number + 1)]
            return _without_delays(_told(left, periods, least), periods, least)
    return cuts


def _corner(stamps: Array, before_s: float, after_s: float, samples: float) -> int:
    """Return the index of the first sample with the new period.

    Parameters
    ----------
    samples
        A step longer than so many of them is a gap.
    """
    most_s = samples * max(before_s, after_s)
    steps = np.clip(np.diff(stamps), -most_s, most_s) - (before_s + after_s) / 2
    # Up to there each step lowers the sum, and from there on raises it.
    total = np.concatenate([[0.0], np.cumsum(steps if after_s > before_s else -steps)])
    return min(int(np.argmin(total)) + 1, len(stamps) - 1)


def _is_loss(stamps: Array, fast_s: float) -> bool:
    """Whether timestamps at the lower rate belong to the other rate, with many samples missing.

    If they are exact, most steps are as long as before, or each is one period or more by chance.
    """
    steps = np.diff(stamps)
    if not len(steps) or (least_s := float(np.percentile(steps, 20))) <= 0:
        return False
    periods = np.rint(steps / least_s)
    is_whole = np.abs(steps / least_s - periods) < _WHOLE * periods
    # Of a smaller change, half of what would be missing is enough.
    by_chance = min(_BY_CHANCE, (float(np.mean(steps)) / fast_s - 1) / 2)
    is_by_chance = np.count_nonzero(is_whole) > _NEARLY_ALL * len(steps) and np.count_nonzero(
        periods > 1
    ) > by_chance * len(steps)
    has_gaps = float(np.mean(steps)) > (1 + 3 * _WHOLE) * fast_s
    is_usual = abs(float(np.median(steps)) / fast_s - 1) < _WHOLE
    return bool(is_by_chance or (has_gaps and is_usual))
