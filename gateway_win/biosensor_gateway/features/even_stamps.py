"""Gives samples of other programs that are stamped in bursts, or with overlaps, even stamps.

A beat that is found in 73 samples with one stamp has no time. So of such a stream the line through
its earliest stamps (`recording.xdf.pace`) is followed, sample by sample. Neat streams pass as they
are and wait for nothing: the first stamp that is not later than the one before tells.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.xdf.pace import STEP_BACK_S, Pace, find_pace

Array = NDArray[np.float64]

SECTION_S, FEWEST = 3.0, 64
"""So much is looked at at once. Of a stream that is not neat it waits for as much that follows."""
SECTIONS = 20
"""As many are remembered, for the line."""
_AT_ONCE = 0.1
"""Part of a period within which two stamps are as good as one."""
_MOST_SLEW = 0.005
"""The line is corrected by this part of the time at most, so that intervals stay right."""


class Steady:
    """Passes samples on; even stamps depend on nothing but the samples, whatever their blocks.

    Parameters
    ----------
    rate
        Nominal, in Hz; above 0.

    Attributes
    ----------
    pace
        Of the newest samples, if they are not neat; None where stamps are as they came.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._section = max(FEWEST, math.ceil(SECTION_S * rate))
        self.pace: Pace | None = None
        self._is_held = False
        self._last = -math.inf
        self._passed = 0
        self._history = np.empty(0)
        self._new: list[tuple[Array, Array]] = []
        self._count = 0
        # What waits for what follows it: whether samples are missing is told by that.
        self._waiting: list[tuple[Array, Array]] = []
        self._next: float | None = None

    def take(self, stamps: Array, values: Array) -> tuple[Array, Array]:
        """Take samples in; return those that are ready, shapes (n,) and (n, n_channels)."""
        ready: list[tuple[Array, Array]] = []
        while len(stamps):
            room = self._section - self._count
            part = stamps[:room], values[:room]
            stamps, values = stamps[room:], values[room:]
            self._count += len(part[0])
            self._new.append(part)
            if not self._is_held:
                ready.append(self._pass())
            if self._count == self._section:
                ready += self._look()
        return _joined(ready, values)

    def _pass(self) -> tuple[Array, Array]:
        """Return the samples before the first that tells of bursts or overlaps, but the last one.

        That waits for the next, for it may be the first of many with one stamp.
        """
        stamps, values = _joined(self._new, self._new[0][1][:0])
        steps = np.diff(stamps, prepend=self._last)
        # A step further back is of another clock, and the next runs see to it.
        is_odd = (steps <= _AT_ONCE / self._rate) & (steps >= -STEP_BACK_S)
        self._is_held = bool(is_odd.any())
        end = int(np.argmax(is_odd)) if self._is_held else len(stamps)
        begin, self._passed = self._passed, max(self._passed, end - 1)
        return stamps[begin : self._passed], values[begin : self._passed]

    def finish(self, channels: int) -> tuple[Array, Array]:
        """Return what still waits for its stamps."""
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
        # Of what was passed nothing tells of bursts, though the history may.
        self._is_held = self._is_held and self.pace is not None
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
        return None if pace.burst == 1 and not pace.overlap_s else pace

    def _even(self, history: Array, begin: int, stamps: Array) -> Array:
        """Return stamps on the line for the samples from number `begin` of the history on."""
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
        told = even[begin : begin + len(stamps)]
        if self._next is not None and begin not in bounds:
            told = self._slewed(told, bounds, begin, period_s)
        self._next = float(told[-1]) + period_s
        return told

    def _slewed(self, told: Array, bounds: list[int], begin: int, period_s: float) -> Array:
        """Go on where the section before has ended, and come to the line little by little."""
        assert self._next is not None
        run_end = min(next(each for each in bounds if each > begin) - begin, len(told))
        behind_s = self._next - float(told[0])
        most_s = _MOST_SLEW * period_s * run_end
        if abs(behind_s) > max(2 * most_s, period_s):
            # It was told wrong, for a hole had not been seen yet: what follows is a run of its own.
            return told
        left = np.maximum(0.0, 1.0 - np.arange(run_end) / run_end)
        return np.concatenate([told[:run_end] + behind_s * left, told[run_end:]])


def _joined(parts: list[tuple[Array, Array]], empty: Array) -> tuple[Array, Array]:
    if not parts:
        return np.empty(0), empty
    return np.concatenate([each for each, _ in parts]), np.concatenate([each for _, each in parts])
