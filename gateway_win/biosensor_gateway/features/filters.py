"""Filters with state, whose results do not depend on how a stream is cut into blocks."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from biosensor_gateway.features.runs import Array, Hops


def band_pass(low_hz: float, high_hz: float, length_s: float, rate: float) -> Array:
    """Return a linear-phase band-pass, a sinc in a Hamming window, shape (n,) with n odd.

    Its delay is ``(n - 1) / 2`` samples, its gain is 0 for a constant and 1 in the middle of the
    band.
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
    """FIR filter for pieces of equal length; the first sample is assumed to have come before."""

    def __init__(self, taps: Array) -> None:
        self._taps = taps
        self._before: Array | None = None

    def take(self, values: Array) -> Array:
        """Return as many values as were given, delayed by half of the filter's length."""
        if self._before is None:
            self._before = np.full(len(self._taps) - 1, values[0])
        joined = np.concatenate([self._before, values])
        self._before = joined[len(values) :]
        return np.convolve(joined, self._taps, "valid")


class Decimator:
    """Averages neighbouring samples, down to a rate from `wanted_hz` to less than twice that.

    Attributes
    ----------
    rate
        Rate of the output, in Hz.
    """

    def __init__(self, rate: float, wanted_hz: float) -> None:
        self._factor = max(1, math.floor(rate / wanted_hz))
        self.rate = rate / self._factor
        self._hops = Hops(self._factor)

    def take(self, stamps: Array, values: Array) -> Iterator[tuple[float, float]]:
        """Yield the stamp of the middle, and the mean, of each group."""
        if self._factor == 1:
            yield from zip(stamps.tolist(), values.tolist(), strict=True)
            return  # nothing is dropped: all samples were given as they are
        for times, group in self._hops.take(stamps, values):
            yield (float(times[0]) + float(times[-1])) / 2, float(group.sum()) / self._factor
