"""Splits skin conductance into its level and its responses.

References are in :mod:`.parameters`.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import NamedTuple

import numpy as np

from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.runs import Array, Decimator, Event
from biosensor_gateway.pulses import MovingMean

_MEDIAN = 0.6745
"""Median of the absolute value of normal noise, in standard deviations."""
_TURNS = 2 / 3
"""Share of samples of noise that are larger or smaller than both neighbours: Bienayme 1874."""


def least_response(levels: Array, rate: float) -> float:
    """Return the smallest response, in microsiemens, above the noise of these levels.

    Noise changes its direction at most samples; responses do not.
    """
    steps = np.diff(levels)
    bends = np.abs(np.diff(steps))
    turns = steps[1:] * steps[:-1] < 0
    if not len(bends) or turns.mean() < _TURNS / 2:
        return at.SCR_LEAST_MICROSIEMENS
    noise = float(np.median(bends)) / _MEDIAN / math.sqrt(6)
    smoothed = noise / math.sqrt(_smoothed(rate))
    return max(at.SCR_LEAST_MICROSIEMENS, at.SCR_NOISE_TIMES * smoothed)


def smoothing_delay_s(rate: float) -> float:
    """Return the delay of the smoothed signal, in s, of a stream with this rate in Hz."""
    slow = Decimator(rate, at.EDA_RATE_HZ).rate
    return (_smoothed(slow) - 1) / 2 / slow if slow else 0.0


def _smoothed(rate: float) -> int:
    """Return the number of samples that are averaged to smooth the signal."""
    return max(1, round(at.SCR_SMOOTHING_S * rate))


class _Point(NamedTuple):
    stamp: float
    level: float


class Skin:
    """Computes `scl` every second, and `scr` and `scr_prominent` after the peak of each response.

    A response is a rise of the smoothed signal from a trough to a peak (Boucsein 2012) that is
    larger than noise. A prominent response has at least a tenth of the largest recent ones, much
    as in NeuroKit2; a smaller one is part of another response's rise or fall.

    Parameters
    ----------
    rate
        Nominal rate in Hz; the values are in microsiemens.
    """

    def __init__(self, rate: float) -> None:
        self._decimator = Decimator(rate, at.EDA_RATE_HZ)
        slow = self._decimator.rate
        self._smooth = MovingMean(_smoothed(slow))
        self._late_s = smoothing_delay_s(slow)
        # nothing is dropped: what a median slides over
        self._levels: deque[float] = deque(maxlen=round(at.SCL_WINDOW_S * slow))
        # nothing is dropped: what is looked at for noise
        self._last: deque[float] = deque(maxlen=round(at.SCR_NOISE_S * slow))
        self._least = at.SCR_LEAST_MICROSIEMENS
        self._every = max(1, round(at.SCL_EVERY_S * slow))
        self._count = 0
        self._responses, self._prominent = _Responses(0.5), _Responses(1.0)
        self._largest = _Largest(max(1, round(at.SCR_STEEP_S * slow)))

    def take(self, stamps: Array, values: Array) -> list[Event]:
        """Take samples of one run in; both of shape (n,)."""
        events: list[Event] = []
        for stamp, value in self._decimator.take(stamps, values):
            self._count += 1
            self._levels.append(value)
            self._last.append(value)
            is_second = self._count % self._every == 0
            if is_second:
                self._least = least_response(np.array(self._last), self._decimator.rate)
                self._responses.raise_limit(self._least)
            if len(self._levels) == self._levels.maxlen and is_second:
                events.append(Event("scl", stamp, (median(self._levels),)))
            events += self._response(_Point(stamp - self._late_s, self._smooth.take(value)))
        return events

    def _response(self, here: _Point) -> list[Event]:
        events: list[Event] = []
        largest = self._largest.take(here)
        if found := self._responses.take(here):
            events.append(Event("scr", *found))
        self._prominent.raise_limit(max(self._least, at.SCR_PROMINENT_SHARE * largest))
        if found := self._prominent.take(here):
            self._largest.add(found[0])
            events.append(Event("scr_prominent", *found))
        return events


_Found = tuple[float, tuple[float, float, float]]


class _Responses:
    """Finds rises from a trough by at least a limit, followed by a fall of a share of the limit."""

    def __init__(self, fall_share: float) -> None:
        self._fall_share = fall_share
        self.raise_limit(at.SCR_LEAST_MICROSIEMENS)
        self._trough: _Point | None = None
        self._peak: _Point | None = None

    def raise_limit(self, limit: float) -> None:
        """Set the height of the smallest response."""
        self._limit, self._fall = limit, self._fall_share * limit

    def take(self, here: _Point) -> _Found | None:
        """Take a point; return peak stamp and values of a response that has ended, else None."""
        if self._trough is None or self._peak is None:
            self._trough = self._peak = here
            return None  # nothing is dropped: the first level of all
        if here.level > self._peak.level:
            self._peak = here
            return None  # nothing is dropped: the response still rises
        height = self._peak.level - self._trough.level
        if self._peak is self._trough or height < self._limit:
            # Not a response yet; a lower trough moves the onset.
            if here.level <= self._trough.level:
                self._trough = self._peak = here
            return None  # nothing is dropped: there is no response yet
        if self._peak.level - here.level < self._fall:
            return None  # nothing is dropped: the response is not over yet
        trough, peak = self._trough, self._peak
        self._trough = self._peak = here
        rise_s = peak.stamp - trough.stamp
        if not at.SCR_RISE_S[0] <= rise_s <= at.SCR_RISE_S[1]:
            # nothing is dropped: what rises so fast or slowly is no response, by definition
            return None
        return peak.stamp, (height, rise_s, trough.level)


class _Largest:
    """Measures the height of the second largest recent response.

    Not the largest, because a touch of an electrode is larger than all responses. A slow rise of
    the level before a response is not part of its height.
    """

    def __init__(self, length: int) -> None:
        # nothing is dropped: what a filter slides over
        self._before: deque[float] = deque(maxlen=length + 1)
        # nothing is dropped: no response rises for longer
        self._rises: deque[_Point] = deque(maxlen=round(2 * at.SCR_RISE_S[1] * length))
        self._kept: deque[_Point] = deque()
        self._second = 0.0

    def take(self, here: _Point) -> float:
        """Take a point; return the height, 0 before there are two responses."""
        self._before.append(here.level)
        self._rises.append(_Point(here.stamp, here.level - min(self._before)))
        if self._kept and self._kept[0].stamp <= here.stamp - at.SCR_LARGEST_S:
            self._kept.popleft()
            self._update()
        return self._second

    def add(self, stamp: float) -> None:
        """Note a response with its peak at this stamp."""
        self._kept.extend(each for each in self._rises if each.stamp == stamp)
        self._update()

    def _update(self) -> None:
        heights = sorted(each.level for each in self._kept)
        self._second = heights[-2] if len(heights) > 1 else 0.0
