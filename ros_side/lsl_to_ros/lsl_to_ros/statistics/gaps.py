"""Finds missing samples of a regular stream by their stamps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from biosensor_common.lsl.inlet import Stamps

# Two samples whose stamps are further apart than this many periods are not neighbours.
GAP_PERIODS = 1.5
# Other programs often stamp with the time at which they push, so their stamps jitter.
FOREIGN_JITTER_S = 0.1
# Stamps that jump to another clock must not make a count that no message can hold.
MOST_MISSING = 1_000_000_000
# Up to so many stamps are looked at one by one, in less time than numpy needs to begin.
FEW = 32


class Gap(NamedTuple):
    """A break before one sample of a block.

    Attributes
    ----------
    place
        Of the first sample after the gap.
    missing
        Samples that would fit into it, an estimate.
    """

    place: int
    missing: int


class GapFinder:
    """Looks at every stamp of one stream, in the order of arrival.

    Parameters
    ----------
    rate
        Nominal, in Hz; an irregular stream (0) has no gaps.
    foreign
        Whether the stamps are another program's, which may be anything.
    """

    def __init__(self, rate: float, *, foreign: bool) -> None:
        self._last: float | None = None
        self._rate = rate
        jitter = FOREIGN_JITTER_S if foreign else 0.0
        self._longest_step = max(GAP_PERIODS / rate, jitter) if rate > 0 else math.inf

    @property
    def last_stamp(self) -> float:
        """Newest finite stamp; 0 before the first."""
        return self._last or 0.0

    def find(self, stamps: Stamps) -> list[Gap]:
        """Take in the stamps of a block; return its gaps."""
        if len(stamps) <= FEW:
            stepwise = enumerate(stamps.tolist())
            return [gap for place, stamp in stepwise for gap in self._find_one(place, stamp)]
        finite = np.flatnonzero(np.isfinite(stamps))
        if not len(finite):
            return []  # nothing is dropped: NaN stamps are reported where they are published
        times = stamps[finite]
        previous, self._last = self._last, float(times[-1])
        if math.isinf(self._longest_step):
            return []  # nothing is dropped: an irregular stream has no gaps
        with np.errstate(over="ignore"):
            steps = np.diff(times, prepend=times[0] if previous is None else previous)
        places = np.flatnonzero(steps > self._longest_step)
        return [self._gap(int(finite[at]), float(steps[at])) for at in places]

    def _find_one(self, place: int, stamp: float) -> Sequence[Gap]:
        if not math.isfinite(stamp):
            return ()  # nothing is dropped: as above
        previous, self._last = self._last, stamp
        if previous is None or stamp - previous <= self._longest_step:
            return ()  # nothing is dropped: there is no gap
        return (self._gap(place, stamp - previous),)

    def _gap(self, place: int, step_s: float) -> Gap:
        periods = step_s * self._rate
        return Gap(place, round(min(periods, MOST_MISSING)) - 1)
