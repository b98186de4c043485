"""Finds pulses in samples of any rate, as they come."""

from __future__ import annotations

from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.filters import Decimator
from biosensor_gateway.features.runs import Array
from biosensor_gateway.pulses.finding import Beat, Pulses


class PulsesOfAnyRate:
    """Gives the apex of each pulse.

    Parameters
    ----------
    rate
        Nominal, in Hz.
    """

    def __init__(self, rate: float) -> None:
        self._decimator = Decimator(rate, at.PULSE_RATE_HZ)
        self._pulses = Pulses(self._decimator.rate)

    def take(self, stamps: Array, values: Array) -> list[Beat]:
        """Return the pulses that are decided by now; both of shape (n,)."""
        found: list[Beat] = []
        for stamp, value in self._decimator.take(stamps, values):
            found += self._pulses.take(stamp, value)
        return found
