"""Turns of a wheel or a crank, of which a device sends the count and the time of the last."""

from __future__ import annotations

import math
from typing import NamedTuple

STANDSTILL_S = 3.0
"""Who turns more slowly than once in this time stands still."""
_TIME_TURNS = 1 << 16


class _Event(NamedTuple):
    """A count, and when it was reached: in ticks, and when it was first heard of on LSL's clock."""

    turns: float
    ticks: float
    heard_s: float


class Revolutions:
    """Counts made rates.

    Parameters
    ----------
    bits
        At which the count rolls over; 0 where it does not, as of a wheel, which may turn
        backwards [1]_. A rate is negative then, as it is when a device counts anew.
    ticks_per_s
        Of the time, which has 16 bits.

    .. [1] Bluetooth SIG, Cycling Speed and Cadence Service 1.0, 3.1.1.
    """

    def __init__(self, bits: int, ticks_per_s: int) -> None:
        self._modulus = 1 << bits if bits else math.inf
        self._ticks_per_s = ticks_per_s
        self._last: _Event | None = None
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
        last, now = self._last, _Event(count, ticks, arrival_s)
        if last is None or (count, ticks) != last[:2]:
            self._last = now
        if last is None:
            return math.nan
        turns = count - last.turns
        if not math.isinf(self._modulus):
            turns %= self._modulus
        elapsed_s = self._elapsed_s(last, now)
        if turns and elapsed_s:
            self._turned_s = arrival_s
            return turns / elapsed_s
        return 0.0 if arrival_s - self._turned_s > STANDSTILL_S else math.nan

    def _elapsed_s(self, last: _Event, now: _Event) -> float:
        """Return the time between two events: how often ticks rolled over, the arrivals tell."""
        rest_s = (now.ticks - last.ticks) % _TIME_TURNS / self._ticks_per_s
        period_s = _TIME_TURNS / self._ticks_per_s
        periods = max(0, round((now.heard_s - last.heard_s - rest_s) / period_s))
        return rest_s + periods * period_s
