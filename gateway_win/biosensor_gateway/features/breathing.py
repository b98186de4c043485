"""Finds breaths in the movement of chest or belly."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.filters import Biquad, Decimator, MovingMean
from biosensor_gateway.features.runs import Array, Event


class _Point(NamedTuple):
    stamp: float
    value: float


class Breathing:
    """Gives `breaths`, `br_live` and `breath_depth` at each end of breathing in.

    The band-passed signal has to go through zero by some of its spread, up and down; the top in
    between is the end of breathing in.

    Parameters
    ----------
    rate
        Nominal, in Hz.
    """

    def __init__(self, rate: float) -> None:
        self._decimator = Decimator(rate, at.BREATH_RATE_HZ)
        slow = self._decimator.rate
        low_hz, high_hz = at.BREATH_BAND_HZ
        self._high_pass = Biquad(low_hz, slow, is_high_pass=True)
        self._low_pass = Biquad(high_hz, slow, is_high_pass=False)
        self._power = MovingMean(round(at.BREATH_SPREAD_S * slow))
        self._kept: deque[_Point] = deque(maxlen=round(at.BREATH_INTERVAL_S[1] * slow))
        self._since = self._up_since = 0
        self._is_up = False
        self._intervals: deque[_Point] = deque()
        self._last = math.nan

    def take(self, stamps: Array, values: Array) -> list[Event]:
        """Take samples of one run in; both of shape (n,)."""
        return [
            event
            for stamp, value in self._decimator.take(stamps, values)
            for event in self._sample(stamp, value)
        ]

    def _sample(self, stamp: float, value: float) -> list[Event]:
        filtered = self._low_pass.take(self._high_pass.take(value))
        limit = at.BREATH_HYSTERESIS * math.sqrt(max(0.0, self._power.take(filtered * filtered)))
        self._kept.append(_Point(stamp, value))
        self._since += 1
        self._up_since += 1
        if self._is_up and filtered < -limit:
            self._is_up = False
            return self._breath()
        if not self._is_up and filtered > limit:
            self._is_up, self._up_since = True, 0
        return []

    def _breath(self) -> list[Event]:
        """Look for top and bottom since the breath before."""
        recent = list(self._kept)[-self._since :]
        top = max(recent[-self._up_since - 1 :], key=lambda each: each.value)
        before = [each.value for each in recent if each.stamp < top.stamp]
        depth = top.value - min(before, default=top.value)
        self._since = sum(each.stamp > top.stamp for each in recent)
        interval_s, self._last = top.stamp - self._last, top.stamp
        low, high = at.BREATH_INTERVAL_S
        if not low <= interval_s <= high:
            # The first, or one after a pause: there is no interval between neighbours.
            self._intervals.clear()
            return []
        self._intervals.append(_Point(top.stamp, interval_s))
        while self._intervals[0].stamp <= top.stamp - at.BR_WINDOW_S:
            self._intervals.popleft()
        events = [
            Event("breaths", top.stamp, (interval_s,)),
            Event("breath_depth", top.stamp, (depth,)),
        ]
        if len(self._intervals) >= at.BR_LEAST:
            total_s = math.fsum(each.value for each in self._intervals)
            rate = 60 * len(self._intervals) / total_s
            events.append(Event("br_live", top.stamp, (rate,)))
        return events
