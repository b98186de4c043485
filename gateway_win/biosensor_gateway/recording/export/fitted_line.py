"""Least-squares line through the times of samples over their index."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(slots=True)
class FittedLine:
    """Line fit for samples without gaps, with sums around the means.

    Attributes
    ----------
    mean_number, mean_s
        The line passes through this point; the first sample has index 0.
    spread, product
        Sum of squares of the indexes, and sum of products of indexes and times; their quotient is
        the slope in s per sample.
    """

    count: int = 0
    mean_number: float = 0.0
    mean_s: float = 0.0
    spread: float = 0.0
    product: float = 0.0

    def add(self, times: NDArray[np.float64]) -> None:
        """Add the next samples; means and sums are combined as in Chan et al. (1983)."""
        count = len(times)
        number = self.count + np.arange(count, dtype=np.float64)
        mean_number, mean_s = float(number.mean()), float(times.mean())
        total = self.count + count
        weight = self.count * count / total
        away, away_s = mean_number - self.mean_number, mean_s - self.mean_s
        self.spread += float(((number - mean_number) ** 2).sum()) + weight * away**2
        self.product += float((number - mean_number) @ (times - mean_s)) + weight * away * away_s
        self.mean_number += away * count / total
        self.mean_s += away_s * count / total
        self.count = total

    def slope_s(self, usual_s: float) -> float:
        """Return the sample period; the usual one if the line is not plausible."""
        slope_s = self.product / self.spread if self.spread else usual_s
        # A few samples with nearly equal times give a meaningless slope.
        return slope_s if 0.5 < slope_s / usual_s < 2 else usual_s

    def times(self, first: int, count: int, usual_s: float) -> NDArray[np.float64]:
        """Return the times on the line of `count` samples from index `first` on."""
        number = np.arange(first, first + count, dtype=np.float64)
        return self.mean_s + self.slope_s(usual_s) * (number - self.mean_number)
