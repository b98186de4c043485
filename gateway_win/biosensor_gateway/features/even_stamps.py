"""Replaces the stamps of other programs' streams that are stamped in bursts or with overlaps.

A beat in 73 samples with the same stamp has no time. So such samples get stamps on the line through
the earliest stamps (`recording.xdf.pace`). Streams with increasing stamps pass unchanged, without
delay, until the first stamp that is not later than the previous one.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.xdf.pace import STEP_BACK_S, Pace, find_pace, is_far_off

Array = NDArray[np.float64]

SECTION_S, FEWEST = 3.0, 64
"""Length of a section. In a stream with bursts, a section waits for the one that follows it."""
SECTIONS = 20
"""Number of sections from which the line is computed."""
_SECTIONS_FOR_RATE = 4
_EARLY_S = (6.0, 12.0, 24.0)
"""After these times a nominal rate is looked at: sections of one that is far too high last long."""
_AT_ONCE = 0.1
"""Part of a period within which two stamps count as equal."""
_MOST_SLEW = 0.005
"""Largest correction of the line relative to time, so that intervals stay right."""


class EvenStamps:
    """Passes samples on with even stamps, which do not depend on how the stream is cut.

    Parameters
    ----------
    rate
        Nominal rate in Hz; above 0.
    is_uneven
        Whether stamps are known to need it, as of a recording. Live, samples before the first
        overlap are passed on at once, and some after it come too early to follow them.
    """

    def __init__(self, rate: float, *, is_uneven: bool = False) -> None:
        self._rate = rate
        self._section = max(FEWEST, math.ceil(SECTION_S * rate))
        # Pace of the newest samples; None while stamps are passed unchanged.
        self.pace: Pace | None = None
        # Rate of the newest samples; None while there are too few to say.
        self.rate_hz: float | None = None
        self._early_s = list(reversed(_EARLY_S))
        self._is_held = self._is_uneven = is_uneven
        self._last = -math.inf
        self._passed = 0
        self._history = np.empty(0)
        self._new: list[tuple[Array, Array]] = []
        self._count = 0
        # Samples that wait for the next section, which shows whether samples are missing.
        self._waiting: list[tuple[Array, Array]] = []
        self._next: float | None = None

    @property
    def room(self) -> int:
        """Number of samples to the next look: at the end of a section, and at first more often."""
        left = self._section - self._count
        return min(left, FEWEST - self._count % FEWEST) if self._early_s else left

    def take(self, stamps: Array, values: Array) -> tuple[Array, Array]:
        """Take samples; return those that are ready, shapes (n,) and (n, n_channels)."""
        ready: list[tuple[Array, Array]] = []
        while len(stamps):
            room = self.room
            part = stamps[:room], values[:room]
            # nothing is dropped: the others are in `part`
            stamps, values = stamps[room:], values[room:]
            self._count += len(part[0])
            self._new.append(part)
            if not self._is_held:
                ready.append(self._pass())
            if self._count == self._section:
                ready += self._look()
            if self._early_s and self._count % FEWEST == 0:
                self._look_early()
        return _joined(ready, values)

    def _look_early(self) -> None:
        stamps = np.concatenate([self._history, *(each for each, _ in self._new)])
        finite = stamps[np.isfinite(stamps)]
        if len(finite) < FEWEST or float(np.ptp(finite)) < self._early_s[-1]:
            return  # nothing is dropped: it only looks at the rate
        self._early_s.pop()
        rate_hz = 1 / find_pace(stamps, self._rate).period_s
        if is_far_off(rate_hz, self._rate):
            self.rate_hz = rate_hz

    def _pass(self) -> tuple[Array, Array]:
        """Return the samples before the first burst or overlap, except the last one.

        The last one waits for the next, because it may be the first of many with the same stamp.
        """
        stamps, values = _joined(self._new, self._new[0][1][:0])
        steps = np.diff(stamps, prepend=self._last)
        # A larger step back is another clock's, which `Runs` handles.
        is_odd = (steps <= _AT_ONCE / self._rate) & (steps >= -STEP_BACK_S)
        self._is_held = bool(is_odd.any())
        end = int(np.argmax(is_odd)) if self._is_held else len(stamps)
        begin, self._passed = self._passed, max(self._passed, end - 1)
        # nothing is dropped: the first of them have passed, the last one waits
        return stamps[begin : self._passed], values[begin : self._passed]

    def finish(self, channels: int) -> tuple[Array, Array]:
        """Return the samples that still wait for their stamps."""
        ready = self._look(is_last=True) if self._new or self._waiting else []
        return _joined(ready, np.empty((0, channels)))

    def _look(self, *, is_last: bool = False) -> list[tuple[Array, Array]]:
        empty = (self._new or self._waiting)[0][1][:0]
        new = _joined(self._new, empty)
        rest = new[0][self._passed :], new[1][self._passed :]
        self._new, self._count, self._passed = [], 0, 0
        history = np.concatenate([self._history, new[0]])
        self.pace = self._pace_of(history)
        ready: list[tuple[Array, Array]] = []
        if not self._is_held:
            ready = [rest]
        else:
            waits = [*self._waiting, rest]
            self._waiting = [] if is_last or self.pace is None else [waits.pop()]
            stamps, values = _joined(waits, empty)
            if len(stamps):
                begin = len(history) - len(stamps) - sum(len(each) for each, _ in self._waiting)
                ready = [(self._even(history, begin, stamps), values)]
        # A section that was passed had no bursts, even if the history has some.
        self._is_held = self._is_uneven or (self._is_held and self.pace is not None)
        if not self._is_held:
            self._next = None
        if len(new[0]):
            self._last = float(new[0][-1])
        self._history = history[-(SECTIONS - 1) * self._section :]
        return ready

    def _pace_of(self, history: Array) -> Pace | None:
        if np.count_nonzero(np.isfinite(history)) < FEWEST // 2:
            return None  # nothing is dropped: what is waited for is kept
        pace = find_pace(history, self._rate)
        if len(history) >= _SECTIONS_FOR_RATE * self._section:
            self.rate_hz = 1 / pace.period_s
        return pace if self._is_uneven or pace.burst > 1 or pace.overlap_s else None

    def _even(self, history: Array, begin: int, stamps: Array) -> Array:
        """Return stamps on the line for the samples from index `begin` of the history on."""
        if self.pace is None:
            return stamps
        period_s = self.pace.period_s
        number = np.arange(len(history))
        rest = history - period_s * number
        rest = np.where(np.isfinite(rest), rest, np.inf)
        bounds = [0, *self.pace.cuts, len(rest)]
        even = np.empty(len(rest))
        for first, end in pairwise(bounds):
            even[first:end] = float(rest[first:end].min()) + period_s * number[first:end]
        section = even[begin : begin + len(stamps)]
        if self._next is not None and begin not in bounds:
            section = self._slewed(section, bounds, begin, period_s)
        self._next = float(section[-1]) + period_s
        return section

    def _slewed(self, section: Array, bounds: list[int], begin: int, period_s: float) -> Array:
        """Continue at the end of the previous section, and approach the line gradually."""
        assert self._next is not None
        run_end = min(next(each for each in bounds if each > begin) - begin, len(section))
        behind_s = self._next - float(section[0])
        most_s = _MOST_SLEW * period_s * run_end
        if abs(behind_s) > max(2 * most_s, period_s):
            # The previous section was wrong, because a gap was not visible yet: begin a new run.
            return section
        left = np.maximum(0.0, 1.0 - np.arange(run_end) / run_end)
        return np.concatenate([section[:run_end] + behind_s * left, section[run_end:]])


def _joined(parts: list[tuple[Array, Array]], empty: Array) -> tuple[Array, Array]:
    if not parts:
        return np.empty(0), empty
    return np.concatenate([each for each, _ in parts]), np.concatenate([each for _, each in parts])
