"""Judges the stamps of another program's regular stream by a line over the sample number.

Such programs often stamp a sample when it arrives, many at once or one after the other, so that
neighbouring stamps say little. Over many samples a stamp is the time of measuring and a delay that
is never negative: the earliest ones lie on a line. Samples are missing where that line jumps ahead
and stays there, by more than it ever moves without.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_LOST = 1_000_000_000
"""Stamps that jump to another clock must not make a count that nobody can read."""
STEP_BACK_S = 1.0
"""Stamps that step back further are of another clock, or of a clock that was set."""
_FEW = 3
NO_PAUSE_S = 3600.0
"""Nobody pauses for longer, for a few samples more."""
_FEWEST = 16
"""In fewer samples no line can be seen."""
_WINDOW_S, _LONGEST_WINDOW_S = 1.0, 16.0
_BURSTS_IN_WINDOW = 8
"""Of so many, one at least came without much delay."""
_FEWEST_WINDOWS = 10
"""Of fewer, nobody knows how far the line moves by itself."""
_AT_ONCE, _NOT_BY_CHANCE = 0.1, 0.3
"""Part of a period within which stamps are as good as one; and part of the steps that are so."""
_NOMINAL_HOLDS = 0.05
"""A rate in a header that is further off is not that of the stream."""
SECTION = 1 << 20
_USUAL, _UNUSUAL = 95, 4
"""Beyond so many times what 95 of 100 moves stay below, in a million moves none is by chance."""


@dataclass(frozen=True, slots=True)
class Hole:
    """A place where samples are missing.

    Attributes
    ----------
    at
        Number of the first sample behind it.
    length_s
        Time between the samples on either side, as the line has it.
    lost
        How many samples would fit into it.
    """

    at: int
    length_s: float
    lost: int


@dataclass(frozen=True, slots=True)
class Pace:
    """How the stamps of a stream lie about a line over the sample number.

    Attributes
    ----------
    period_s
        Between two samples, by the slope of the line.
    burst
        How many samples are stamped at once, or as good as; 1 where each has its own time.
    spread_s
        By how much stamps are usually later than the line, at most.
    moves_s
        By how much the line moves without a hole.
    overlap_s
        By how much a stamp is earlier than the one before it because of that, at most.
    holes
        In their order.
    turns
        Numbers of the samples at which stamps step back by more than `STEP_BACK_S`, or the line
        falls and stays there.
    odd_steps_back
        How often a stamp is earlier than the one before by more than bursts and jitter explain.
    stray
        Numbers of the samples whose stamps are far away from those before and behind them.
    """

    period_s: float
    burst: int
    spread_s: float
    moves_s: float
    overlap_s: float
    holes: tuple[Hole, ...]
    turns: tuple[int, ...]
    odd_steps_back: int
    stray: tuple[int, ...]
    ends_astray: bool = False
    """Whether the last sample is stray, and more than a pause away."""

    @property
    def cuts(self) -> tuple[int, ...]:
        """Numbers of the samples with which a run begins, but for the first one."""
        return tuple(sorted({*(each.at for each in self.holes), *self.turns}))


def find_pace(stamps: Array, nominal_hz: float) -> Pace:
    """Find line, bursts and holes.

    Parameters
    ----------
    stamps : ndarray of float64, shape (n_samples,)
        In the order of the file, in s; two at least are finite.
    nominal_hz
        Rate that the header names; above 0.
    """
    is_number = np.isfinite(stamps)
    is_stray = is_number & _stray(_filled(stamps, is_number), 1.0 / nominal_hz)
    last = float(stamps[-1])
    stamps = _filled(stamps, is_number & ~is_stray)
    steps = np.diff(stamps)
    turns = (np.flatnonzero(steps < -STEP_BACK_S) + 1).tolist()
    window, period_s = _window_and_period(stamps, steps, 1.0 / nominal_hz)
    rests = _rests(stamps, turns, period_s)
    spread_s, moves_s = _spread(rests, window, period_s)
    falls = [
        begin + at
        for begin, rest in zip([0, *turns], rests, strict=True)
        for at in _falls(rest, max(period_s / 2, _UNUSUAL * spread_s), window)
    ]
    if falls:
        turns = sorted([*turns, *falls])
        rests = _rests(stamps, turns, period_s)
        spread_s, moves_s = _spread(rests, window, period_s)
    bounds = [0, *turns, len(stamps)]
    most_s = max(period_s / 2, _UNUSUAL * moves_s)
    holes = [
        Hole(begin + at, jump_s + period_s, round(min(jump_s / period_s, MOST_LOST)))
        for begin, rest in zip(bounds, rests, strict=False)
        for at, jump_s in _jumps(rest, period_s, spread_s, most_s, window)
    ]
    cuts = sorted({0, *(each.at for each in holes), *turns, len(stamps)})
    runs = [stamps[begin:end] for begin, end in pairwise(cuts)]
    back = -steps[steps < 0]
    usual = back[back <= max(period_s, _UNUSUAL * spread_s)]
    return Pace(
        _slope_s(runs, period_s, window),
        _burst(steps, period_s),
        spread_s,
        moves_s,
        float(usual.max()) if len(usual) else 0.0,
        tuple(holes),
        tuple(turns),
        len(back) - len(usual),
        tuple(np.flatnonzero(is_stray).tolist()),
        bool(is_stray[-1]) and abs(last - stamps[-1]) > NO_PAUSE_S,
    )


class Cuts:
    """Finds where runs begin in a stream that comes in blocks.

    Parameters
    ----------
    nominal_hz
        Rate that the header names; above 0.
    section
        How many samples are looked at together, so that no memory grows with the recording.

    Attributes
    ----------
    numbers
        Those of the samples with which a run begins, but for the first one, as far as known.
    holes, stray
        As far as known; see `Pace`.
    period_s
        Between two samples, by the longest section; nominal before there is one.
    """

    def __init__(self, nominal_hz: float, section: int = SECTION) -> None:
        self._nominal_hz, self._section = nominal_hz, section
        self.period_s = 1.0 / nominal_hz
        self.numbers: list[int] = []
        self.holes: list[Hole] = []
        self.stray: list[int] = []
        self._blocks: list[Array] = []
        self._begin = self._held = self._longest = 0

    def take(self, times: Array) -> None:
        """Take in the times of the samples that follow; finite, shape (n_samples,)."""
        self._blocks.append(times)
        self._held += len(times)
        if self._held >= self._section:
            # What is near the border of a section cannot be judged by what follows.
            kept = self._look()[-self._section // 2 :]
            self._begin += self._held - len(kept)
            self._blocks, self._held = [kept], len(kept)

    def end(self) -> None:
        """Say that there are no more."""
        if self._held:
            self._look()

    def _look(self) -> Array:
        section = np.concatenate(self._blocks)
        if len(section) < 2:
            return section
        pace = find_pace(section, self._nominal_hz)
        # The border is looked at twice.
        last = self.numbers[-1] if self.numbers else 0
        self.numbers += [each for at in pace.cuts if (each := self._begin + at) > last]
        self.holes += [
            replace(hole, at=at) for hole in pace.holes if (at := self._begin + hole.at) > last
        ]
        last = self.stray[-1] if self.stray else -1
        self.stray += [each for at in pace.stray if (each := self._begin + at) > last]
        if len(section) > self._longest:
            self._longest, self.period_s = len(section), pace.period_s
        return section


def _filled(stamps: Array, is_good: NDArray[np.bool_]) -> Array:
    """Return the stamps with others in place of those that are not good, between the good ones."""
    if is_good.all():
        return stamps
    number = np.arange(len(stamps))
    return np.interp(number, number[is_good], stamps[is_good])


def _stray(stamps: Array, nominal_s: float) -> NDArray[np.bool_]:
    """Find stamps that leave the line and are back on it after a few samples, or end with that."""
    is_stray = np.zeros(len(stamps), bool)
    far = np.flatnonzero(np.abs(np.diff(stamps)) > max(STEP_BACK_S, 10 * nominal_s)) + 1
    for at in far.tolist():
        if is_stray[at] or is_stray[at - 1]:
            continue
        away_s = abs(stamps[at] - stamps[at - 1])
        for behind in range(at + 1, min(at + 1 + _FEW, len(stamps))):
            if abs(stamps[behind] - stamps[at - 1]) <= away_s / 2:
                is_stray[at:behind] = True
                break
        else:
            # An outlet that ends while it is recorded may leave garbage behind its last sample.
            is_last = at + _FEW >= len(stamps) > 2 * _FEW
            if is_last and away_s > NO_PAUSE_S:
                is_stray[at:] = True
    return is_stray


def _window_and_period(stamps: Array, steps: Array, nominal_s: float) -> tuple[int, float]:
    """Return in how many samples the line can be seen, and its usual slope there."""
    usual_s = float(np.median(steps)) if len(steps) else nominal_s
    if _is_stamped_at_once(steps, nominal_s):
        # The last one of those that are stamped at once was measured last.
        marks = np.flatnonzero(steps > _AT_ONCE * nominal_s)
        pushes, lag = marks, _BURSTS_IN_WINDOW
    else:
        if usual_s > 0 and abs(usual_s / nominal_s - 1) > _NOMINAL_HOLDS:
            nominal_s = usual_s
        marks = np.arange(len(stamps))
        # What comes after something late comes sooner; what comes after a hole does not.
        pushes, lag = np.flatnonzero(steps < usual_s / 2), 0
    several = 0.0
    if len(pushes) > 1:
        several = _BURSTS_IN_WINDOW * float(np.median(np.diff(pushes)))
    wanted = max(_WINDOW_S / nominal_s, min(several, _LONGEST_WINDOW_S / nominal_s))
    # Of a short stream some windows are better than long ones, if each has some bursts.
    most = len(steps) / (2 if several else _FEWEST_WINDOWS)
    window = max(_FEWEST, int(min(wanted, most)))
    lag = lag or window
    if len(marks) < _FEWEST_WINDOWS * lag:
        return window, nominal_s
    # Holes are in fewer than half of them.
    slopes = (stamps[marks[lag:]] - stamps[marks[:-lag]]) / (marks[lag:] - marks[:-lag])
    slope_s = float(np.median(slopes))
    is_usual = np.abs(steps - usual_s) < _NOMINAL_HOLDS * usual_s
    if lag == window and is_usual.mean() > 0.5 and abs(slope_s / usual_s - 1) > _NOMINAL_HOLDS:
        # No clock is so wrong, so there are holes everywhere.
        return window, usual_s
    return window, slope_s if slope_s > 0 else nominal_s


def _is_late(rest_steps: Array, period_s: float) -> bool:
    """Whether some came late: what comes after that comes sooner."""
    return bool((rest_steps < -period_s / 2).any())


def _spread(rests: list[Array], window: int, period_s: float) -> tuple[float, float]:
    """Return how much later than the line stamps are, and how far it moves without a hole."""
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
    # A hole moves it ahead and never back; all else moves it both ways.
    back = -moves[moves < 0]
    moves_s = float(np.percentile(back, _USUAL)) if len(back) else 0.0
    spread_s = float(np.median(spans))
    if not any(_is_late(np.diff(each), period_s) for each in rests):
        return spread_s, moves_s
    # What a few windows show may be less than what comes to pass.
    part = _UNUSUAL if len(moves) < _FEWEST_WINDOWS else _UNUSUAL**2
    return spread_s, max(moves_s, spread_s / part)


def _jumps(
    rest: Array, period_s: float, spread_s: float, most_s: float, window: int
) -> list[tuple[int, float]]:
    """Find where the line jumps and stays, and how far."""
    steps = np.diff(rest)
    places = np.flatnonzero(steps > period_s / 2) + 1
    lowest = _lowest(rest, window)
    jumps = lowest[places] - lowest[np.maximum(places - window, 0)]
    places = places[(jumps > most_s) | (places < window)]
    # Of a few samples all may be late, and of one packet very much.
    late_s = max(most_s, _UNUSUAL * spread_s if _is_late(steps, period_s) else 0.0)
    found: dict[int, float] = {}
    bounds = [0, len(rest)]
    # The greatest first: beside a hole there are fewer samples by which to judge another place.
    waiting = places[np.argsort(-steps[places - 1], kind="stable")].tolist()
    while waiting:
        again: list[int] = []
        for place in waiting:
            at = bisect_left(bounds, place)
            before = rest[max(bounds[at - 1], place - window) : place]
            following = rest[place : min(bounds[at], place + window)]
            before_s = float(before.min())
            # What was only held up comes all at once: as many samples later it is on the line.
            held_up = int(1.5 * (float(following.max()) - before_s) / period_s) + 1
            after_s = float(rest[place : min(bounds[at], place + max(window, held_up))].min())
            is_told = min(len(before), len(following)) >= window
            jump_s = after_s - before_s
            if jump_s <= (most_s if is_told else late_s):
                continue
            if jump_s >= 2 * steps[place - 1]:
                # There is another one near, which may be found yet.
                again.append(place)
                continue
            found[place] = jump_s
            bounds.insert(at, place)
        waiting = again if len(again) < len(waiting) else []
    return sorted(found.items())


def _rests(stamps: Array, turns: list[int], period_s: float) -> list[Array]:
    """Return how far the stamps are above a line through the first of each part."""
    parts = [stamps[begin:end] for begin, end in pairwise([0, *turns, len(stamps)])]
    return [part - period_s * np.arange(len(part)) for part in parts]


def _falls(rest: Array, most_s: float, window: int) -> list[int]:
    """Find where the line falls and stays: samples stand there twice, or the clock was set back."""
    found: list[int] = []
    for place in (np.flatnonzero(np.diff(rest) < -most_s) + 1).tolist():
        begin = max(found[-1] if found else 0, place - window)
        before, following = rest[begin:place], rest[place : place + window]
        is_told = min(len(before), len(following)) >= window
        # What had only come late was above the line; before a fall all is.
        if is_told and float(before.min()) - float(following.max()) > most_s:
            found.append(place)
    return found


def _lowest(values: Array, window: int) -> Array:
    """Return the least of as many values from each one on; fewer at the end."""
    found, length = values.copy(), 1
    while length < min(window, len(values)):
        step = min(length, window - length)
        found[:-step] = np.minimum(found[:-step], found[step:])
        length += step
    return found


def _slope_s(runs: list[Array], usual_s: float, window: int) -> float:
    """Return the slope of one line through the earliest stamps of all runs, by least squares."""
    products = squares = 0.0
    for run in runs:
        number = np.arange(len(run), dtype=np.float64)
        rest = run - usual_s * number
        lowest = _lowest(rest, window)
        earlier = np.roll(lowest, min(window, len(run)) - 1)
        is_early = rest - np.minimum(lowest, earlier) <= usual_s
        number, rest = number[is_early], rest[is_early]
        number -= number.mean()
        products += float(number @ (rest - rest.mean()))
        squares += float(number @ number)
    slope_s = usual_s + products / squares if squares else usual_s
    return slope_s if slope_s > 0 else usual_s


def _is_stamped_at_once(steps: Array, period_s: float) -> bool:
    """Whether samples share a time, or as good as, and not by chance."""
    at_once = np.count_nonzero(np.abs(steps) <= _AT_ONCE * period_s)
    return bool(at_once > _NOT_BY_CHANCE * len(steps))


def _burst(steps: Array, period_s: float) -> int:
    """Return how many samples share a time, or as good as; 1 where none do."""
    if not _is_stamped_at_once(steps, period_s):
        return 1
    ends = np.flatnonzero(np.abs(steps) > _AT_ONCE * period_s)
    return round(float(np.median(np.diff(ends)))) if len(ends) > 1 else len(steps) + 1
