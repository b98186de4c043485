"""Filters with state; a sample has the same result whatever came with it in a block."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

import numpy as np

from biosensor_gateway.features.runs import Array, Hops


def band_pass(low_hz: float, high_hz: float, length_s: float, rate: float) -> Array:
    """Return a linear-phase band-pass, a sinc in a Hamming window, shape (n,) with n odd.

    Its delay is ``(n - 1) / 2`` samples, it lets no constant pass, and its gain is 1 in the
    middle of the band.
    """
    half = max(1, round(length_s * rate / 2))
    n = np.arange(-half, half + 1)
    window = np.hamming(len(n))

    def low_pass(cut_hz: float) -> Array:
        taps = np.sinc(2 * min(cut_hz, 0.49 * rate) / rate * n) * window
        return taps / taps.sum()

    taps = low_pass(high_hz) - low_pass(low_hz)
    gain = abs((taps * np.exp(-1j * math.pi * (low_hz + high_hz) / rate * n)).sum())
    return taps / gain


class Fir:
    """Convolves pieces of one length; what came before the first sample was like it."""

    def __init__(self, taps: Array) -> None:
        self._taps = taps
        self._before: Array | None = None

    def take(self, values: Array) -> Array:
        """Return as many values as were given, late by half of the filter."""
        if self._before is None:
            self._before = np.full(len(self._taps) - 1, values[0])
        joined = np.concatenate([self._before, values])
        self._before = joined[len(values) :]
        return np.convolve(joined, self._taps, "valid")


def between_samples(before: float, apex: float, after: float) -> float:
    """Return where the top of the parabola through three samples is, from the middle one on.

    In sampling intervals, half of one at most.
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
        """Return the next value; it begins as if the first had been there for ever."""
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
    """The mean of the last values; before there are enough, of all.

    It is summed up anew now and then, so that rounding never piles up.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self._values: deque[float] = deque(maxlen=length)
        self._sum, self._count = 0.0, 0

    def take(self, value: float) -> float:
        """Return the mean with this value."""
        if len(self._values) == self._length:
            self._sum -= self._values[0]
        self._values.append(value)
        self._sum += value
        self._count += 1
        if self._count % (16 * self._length) == 0:
            self._sum = math.fsum(self._values)
        return self._sum / len(self._values)


class Decimator:
    """Averages neighbours, so that what follows sees at least `wanted_hz` and less than twice it.

    Attributes
    ----------
    rate
        Of what it gives, in Hz.
    """

    def __init__(self, rate: float, wanted_hz: float) -> None:
        self._factor = max(1, math.floor(rate / wanted_hz))
        self.rate = rate / self._factor
        self._hops = Hops(self._factor)

    def take(self, stamps: Array, values: Array) -> Iterator[tuple[float, float]]:
        """Give stamp and mean of each group; the stamp is that of its middle."""
        if self._factor == 1:
            yield from zip(stamps.tolist(), values.tolist(), strict=True)
            return
        for times, group in self._hops.take(stamps, values):
            yield (float(times[0]) + float(times[-1])) / 2, float(group.sum()) / self._factor
