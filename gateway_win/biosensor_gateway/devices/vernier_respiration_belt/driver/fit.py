"""Judges by the measured force whether the belt sits well."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from statistics import fmean, pstdev

LOOSE = -1.0
GOOD = 0.0
TIGHT = 1.0

LOOSE_BELOW_N = 1.0
TIGHT_ABOVE_N = 40.0
JUDGED_S = 3.0
"""About one breath: what one sample is does not matter."""
FLAT_BELOW_N = 0.02
FLAT_FOR_S = 10.0
"""Nobody holds his breath so still: a standard deviation below means that nobody wears it."""


class Fit:
    """The last seconds of the force.

    Parameters
    ----------
    period_s
        Sampling period.
    """

    def __init__(self, period_s: float) -> None:
        self._breath: deque[float] = deque(maxlen=max(1, round(JUDGED_S / period_s)))
        self._still: deque[float] = deque(maxlen=max(2, round(FLAT_FOR_S / period_s)))

    def add(self, forces: Iterable[float]) -> None:
        """Take in samples in newtons; NaN is passed over."""
        finite = [force for force in forces if math.isfinite(force)]
        self._breath.extend(finite)
        self._still.extend(finite)

    @property
    def tension(self) -> float:
        """-1 loose or not worn, 0 good, 1 tight; NaN before the first sample."""
        if not self._breath:
            return math.nan
        mean = fmean(self._breath)
        if mean < LOOSE_BELOW_N or self._is_flat():
            return LOOSE
        return TIGHT if mean > TIGHT_ABOVE_N else GOOD

    def _is_flat(self) -> bool:
        return len(self._still) == self._still.maxlen and pstdev(self._still) < FLAT_BELOW_N
