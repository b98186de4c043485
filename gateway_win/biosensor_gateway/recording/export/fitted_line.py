"""A line through the times of samples over their numbers, by least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(slots=True)
class FittedLine:
    """Samples without a gap between them: number against time, as sums around their means.

    Attributes
    ----------
    mean_number, mean_s
        The line goes through this point; the first sample has number 0.
    spread, product
        Sum of squares of the numbers, and of products of numbers and times; their quotient is the
        slope, in s a sample.
    """

    count: int = 0
    mean_number: float = 0.0
    mean_s: float = 0.0
    spread: float = 0.0
    product: float = 0.0

    def add(self, times: NDArray[np.float64]) -> None:
        """Take in the samples that follow; means and sums are joined as Chan et al. (1983) do."""
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
        """Return the time from sample to sample; the usual one if no line can be seen."""
        slope_s = self.product / self.spread if self.spread else usual_s
        # A few samples that came at once tell nothing.
        return slope_s if 0.5 < slope_s / usual_s < 2 else usual_s

    def times(self, first: int, count: int, usual_s: float) -> NDArray[np.float64]:
        """Return the times that samples of these numbers have on the line."""
        number = np.arange(first, first + count, dtype=np.float64)
        return self.mean_s + self.slope_s(usual_s) * (number - self.mean_number)
