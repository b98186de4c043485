"""Turns of a wheel or a crank, of which a device sends the count and the time of the last."""

from __future__ import annotations

import math

STANDSTILL_S = 3.0
"""Who turns more slowly than once in this time stands still."""
_TIME_TURNS = 1 << 16


class Revolutions:
    """Counts that roll over, made rates.

    Parameters
    ----------
    bits
        Of the count.
    ticks_per_s
        Of the time, which has 16 bits.
    """

    def __init__(self, bits: int, ticks_per_s: int) -> None:
        self._modulus = 1 << bits
        self._ticks_per_s = ticks_per_s
        self._last: tuple[float, float] | None = None
        self._turned_s = -math.inf

    def rate(self, count: float | None, ticks: float | None, arrival_s: float) -> float:
        """Return turns per second since the last one; NaN while that is not known.

        Parameters
        ----------
        count, ticks
            As the device sends them; None where it does not.
        arrival_s
            LSL clock.
        """
        if count is None or ticks is None:
            return math.nan
        last, self._last = self._last, (count, ticks)
        if last is None:
            return math.nan
        turns = (count - last[0]) % self._modulus
        elapsed_s = (ticks - last[1]) % _TIME_TURNS / self._ticks_per_s
        if turns and elapsed_s:
            self._turned_s = arrival_s
            return turns / elapsed_s
        return 0.0 if arrival_s - self._turned_s > STANDSTILL_S else math.nan
