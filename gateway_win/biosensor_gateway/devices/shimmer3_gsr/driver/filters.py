"""Causal filters of first and second order, one sample at a time."""

from __future__ import annotations

from math import cos, pi, sin, sqrt


class LowPass:
    """Second-order Butterworth low-pass (bilinear transform, direct form II transposed).

    Parameters
    ----------
    cutoff_hz, rate_hz
    """

    def __init__(self, cutoff_hz: float, rate_hz: float) -> None:
        omega = 2 * pi * cutoff_hz / rate_hz
        alpha = sin(omega) / sqrt(2)
        scale = 1 + alpha
        self._b = (1 - cos(omega)) / (2 * scale)
        self._a1 = -2 * cos(omega) / scale
        self._a2 = (1 - alpha) / scale
        self._s1 = self._s2 = 0.0

    def step(self, value: float) -> float:
        """Take the next sample, return the filtered one."""
        output = self._b * value + self._s1
        self._s1 = 2 * self._b * value - self._a1 * output + self._s2
        self._s2 = self._b * value - self._a2 * output
        return output


class HighPass:
    """First-order high-pass.

    Parameters
    ----------
    cutoff_hz, rate_hz
    """

    def __init__(self, cutoff_hz: float, rate_hz: float) -> None:
        self._keep = 1 / (1 + 2 * pi * cutoff_hz / rate_hz)
        self._input = self._output = 0.0

    def step(self, value: float) -> float:
        """Take the next sample, return the filtered one."""
        self._output = self._keep * (self._output + value - self._input)
        self._input = value
        return self._output
