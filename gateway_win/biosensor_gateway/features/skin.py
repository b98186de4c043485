"""Splits skin conductance into its level and its responses."""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import NamedTuple

from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.filters import Decimator, MovingMean
from biosensor_gateway.features.runs import Array, Event


class _Point(NamedTuple):
    stamp: float
    level: float


class Skin:
    """Gives `scl` every second and `scr` at each response, once its peak is passed.

    A response is what the smoothed signal rises from a trough to a peak, the classic way of
    Boucsein 2012; limits are in :mod:`.thresholds`.

    Parameters
    ----------
    rate
        Nominal, in Hz; the values are in microsiemens.
    """

    def __init__(self, rate: float) -> None:
        self._decimator = Decimator(rate, at.EDA_RATE_HZ)
        slow = self._decimator.rate
        length = max(1, round(at.SCR_SMOOTHING_S * slow))
        self._smooth = MovingMean(length)
        self._late_s = (length - 1) / 2 / slow
        self._levels: deque[float] = deque(maxlen=round(at.SCL_WINDOW_S * slow))
        self._every = max(1, round(at.SCL_EVERY_S * slow))
        self._count = 0
        self._trough: _Point | None = None
        self._peak: _Point | None = None

    def take(self, stamps: Array, values: Array) -> list[Event]:
        """Take samples of one run in; both of shape (n,)."""
        events: list[Event] = []
        for stamp, value in self._decimator.take(stamps, values):
            self._count += 1
            self._levels.append(value)
            if len(self._levels) == self._levels.maxlen and self._count % self._every == 0:
                events.append(Event("scl", stamp, (median(self._levels),)))
            events += self._response(stamp, value)
        return events

    def _response(self, stamp: float, value: float) -> list[Event]:
        here = _Point(stamp - self._late_s, self._smooth.take(value))
        if self._trough is None or self._peak is None:
            self._trough = self._peak = here
            return []
        if here.level > self._peak.level:
            self._peak = here
            return []
        height = self._peak.level - self._trough.level
        if self._peak is self._trough or height < at.SCR_LEAST_MICROSIEMENS:
            # Not a response yet: a lower trough is a later onset.
            if here.level <= self._trough.level:
                self._trough = self._peak = here
            return []
        if self._peak.level - here.level < at.SCR_LEAST_MICROSIEMENS / 2:
            return []
        trough, peak = self._trough, self._peak
        self._trough = self._peak = here
        rise_s = peak.stamp - trough.stamp
        if not at.SCR_RISE_S[0] <= rise_s <= at.SCR_RISE_S[1]:
            return []
        return [Event("scr", peak.stamp, (height, rise_s, trough.level))]
