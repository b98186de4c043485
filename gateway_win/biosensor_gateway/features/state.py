"""Computes the state of a rate: its newest value, with age and quality."""

from __future__ import annotations

import math
from collections.abc import Sequence

from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.runs import Event

HR_STATE, BR_STATE = "hr_state", "br_state"


class State:
    """Stores the newest value of a rate, and the quality of its signal.

    Parameters
    ----------
    name
        Name of the state's feature.
    rate, beside
        Names of the features with the rate, and with its number of intervals.
    every_s
        Longest time between two values while nothing is wrong, in s.
    """

    def __init__(self, name: str, rate: str, beside: str, every_s: float) -> None:
        self._name, self._rate, self._beside = name, rate, beside
        self._holds_s = every_s + at.LUMP_S
        self._stamp = self._value = self._count = self._quality = math.nan

    def note(self, events: Sequence[Event]) -> None:
        """Note the values of events."""
        for each in events:
            if each.feature == self._rate:
                self._stamp, self._value = each.stamp, each.values[0]
            elif each.feature == self._beside:
                self._count = each.values[0]
            elif each.feature == "sqi":
                self._quality = each.values[0]

    def at(self, stamp: float) -> Event:
        """Return value, age (s), quality, motion and count at a time.

        The value is NaN when the newest one is outdated. Motion is NaN; `Beside` fills it in.
        """
        age_s = stamp - self._stamp
        if not age_s <= self._holds_s:
            return Event(self._name, stamp, (math.nan, age_s, self._quality, math.nan, 0.0))
        values = (self._value, age_s, self._quality, math.nan, self._count)
        return Event(self._name, stamp, values)
