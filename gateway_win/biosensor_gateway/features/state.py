"""Joins what is known of a rate at a time: the newest value, how old it is, and how good."""

from __future__ import annotations

import math
from collections.abc import Sequence

from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.runs import Event

HR_STATE, BR_STATE = "hr_state", "br_state"


class State:
    """Keeps the newest value of a rate, and the quality of its signal.

    Parameters
    ----------
    name
        Of the feature that it gives.
    rate, beside
        Features: the rate, and what says how many intervals it is of.
    every_s
        How long it takes at most from one value to the next while all is well, in s.
    """

    def __init__(self, name: str, rate: str, beside: str, every_s: float) -> None:
        self._name, self._rate, self._beside = name, rate, beside
        self._holds_s = every_s + at.LUMP_S
        self._stamp = self._value = self._count = self._quality = math.nan

    def note(self, events: Sequence[Event]) -> None:
        """Take note of what was told."""
        for each in events:
            if each.feature == self._rate:
                self._stamp, self._value = each.stamp, each.values[0]
            elif each.feature == self._beside:
                self._count = each.values[0]
            elif each.feature == "sqi":
                self._quality = each.values[0]

    def at(self, stamp: float) -> Event:
        """Return value, age (s), quality, motion and count at this time.

        There is no value where none was told for so long that it would not be one of now. Motion is
        told by another: it is NaN here.
        """
        age_s = stamp - self._stamp
        if not age_s <= self._holds_s:
            return Event(self._name, stamp, (math.nan, age_s, self._quality, math.nan, 0.0))
        values = (self._value, age_s, self._quality, math.nan, self._count)
        return Event(self._name, stamp, values)
