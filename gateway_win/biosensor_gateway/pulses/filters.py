"""Filters for single samples; parabolic interpolation, skewness and kurtosis."""

from __future__ import annotations

import math
from collections import deque
from typing import Literal

import numpy as np
from numpy.typing import NDArray


def between_samples(before: float, apex: float, after: float) -> float:
    """Return the vertex of the parabola through three samples, relative to the middle one.

    In sampling intervals, from -0.5 to 0.5.
    """
    bend = before - 2 * apex + after
    return min(0.5, max(-0.5, (before - after) / (2 * bend))) if bend else 0.0


class Biquad:
    """A second-order Butterworth filter, sample by sample, in transposed direct form II.

    Coefficients are those of the bilinear transform, as in R. Bristow-Johnson's "Cookbook
    formulae for audio EQ biquad filter coefficients" with Q = 1/sqrt(2).
    """

    def __init__(self, cut_hz: float, rate: float, *, is_high_pass: bool) -> None:
        angle = 2 * math.pi * min(cut_hz, 0.45 * rate) / rate
        cosine, alpha = math.cos(angle), math.sin(angle) / math.sqrt(2)
        side = (1 + cosine) / 2 if is_high_pass else (1 - cosine) / 2
        middle = -2 * side if is_high_pass else 2 * side
        scale = 1 + alpha
        self._b0, self._b1 = side / scale, middle / scale
        self._a1, self._a2 = -2 * cosine / scale, (1 - alpha) / scale
        self._is_high_pass = is_high_pass
        self._s1 = self._s2 = 0.0
        self._is_settled = False

    def take(self, value: float) -> float:
        """Return the next value; the filter starts in the steady state for the first value."""
        if not self._is_settled:
            self._is_settled = True
            out = 0.0 if self._is_high_pass else value
            self._s2 = self._b0 * value - self._a2 * out
            self._s1 = self._s2 + self._b1 * value - self._a1 * out
        out = self._b0 * value + self._s1
        self._s1 = self._b1 * value - self._a1 * out + self._s2
        self._s2 = self._b0 * value - self._a2 * out
        return out


class MovingMean:
    """The mean of the last values, or of all values while there are fewer."""

    def __init__(self, length: int) -> None:
        self._length = length
        # nothing is dropped: what a filter slides over
        self._values: deque[float] = deque(maxlen=length)
        self._sum, self._count = 0.0, 0

    def take(self, value: float) -> float:
        """Return the mean with this value."""
        if len(self._values) == self._length:
            self._sum -= self._values[0]
        self._values.append(value)
        self._sum += value
        self._count += 1
        # Summed again from time to time, so that rounding errors do not accumulate.
        if self._count % (16 * self._length) == 0:
            self._sum = math.fsum(self._values)
        return self._sum / len(self._values)


def moment(values: NDArray[np.float64], order: Literal[3, 4]) -> float:
    """Return skewness or kurtosis; 0 for constant values."""
    centred = values - values.mean()
    spread = float(np.sqrt(np.square(centred).mean()))
    if spread <= 0:
        return 0.0
    scaled: NDArray[np.float64] = centred / spread
    squares = np.square(scaled)
    # Not np.power, which takes twenty times as long.
    return float((squares * (scaled if order == 3 else squares)).mean())
