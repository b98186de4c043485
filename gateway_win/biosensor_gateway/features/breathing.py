"""Finds breaths in the movement of chest or belly.

References are in :mod:`.parameters`.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import fmean, median
from typing import NamedTuple

from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.runs import Array, Decimator, Event
from biosensor_gateway.pulses import Biquad

BR_QUALITY = "br_live_quality"
_NOISE_EVERY = 16


class _Point(NamedTuple):
    stamp: float
    value: float


class Breathing:
    """Computes `breaths`, `breath_depth`, `br_live` and `br_live_quality` after each inspiration.

    A turning point of the smoothed signal is where it has moved back by a share of its usual span;
    smaller movements belong to the same breath. Maxima are ends of inspirations.

    Parameters
    ----------
    rate
        Nominal rate in Hz.
    """

    def __init__(self, rate: float) -> None:
        self._decimator = Decimator(rate, at.BREATH_RATE_HZ)
        cut_hz = at.BREATH_BAND_HZ[1]
        self._smooth = Biquad(cut_hz, self._decimator.rate, is_high_pass=False)
        # Delay of a second-order Butterworth filter for slow signals.
        self._late_s = math.sqrt(2) / (2 * math.pi * cut_hz)
        length = round(at.BREATH_BLOCK_S * self._decimator.rate)
        self._usual = _Usual(length)
        # What a second-order Butterworth filter leaves of white noise.
        passes = min(1.0, 2.22 * cut_hz / self._decimator.rate)
        self._noise = _Noise(at.BREATH_BLOCKS * length, math.sqrt(passes))
        self._low = self._high = _Point(math.nan, math.nan)
        self._is_up = False
        self._last = math.nan
        self._intervals: deque[_Point] = deque()

    def take(self, stamps: Array, values: Array) -> list[Event]:
        """Take samples of one run in; both of shape (n,)."""
        return [
            event
            for stamp, value in self._decimator.take(stamps, values)
            for event in self._sample(_Point(stamp - self._late_s, self._smoothed(value)))
        ]

    def _smoothed(self, value: float) -> float:
        self._noise.take(value)
        return self._smooth.take(value)

    def _sample(self, here: _Point) -> list[Event]:
        usual = self._usual.take(here.value)
        noise = at.BREATH_NOISE_TIMES * self._noise.value
        limit = max(at.BREATH_HYSTERESIS * usual, min(at.BREATH_NOISE_SHARE * usual, noise))
        if limit <= 0:
            self._low = self._high = here
            return []  # nothing is dropped: nothing is known yet, or nothing moves
        if self._is_up:
            self._high = max(self._high, here, key=_value)
            if self._high.value - here.value >= limit:
                self._is_up, top = False, self._high
                depth, self._low = top.value - self._low.value, here
                return self._breath(top.stamp, depth)
        else:
            self._low = min(self._low, here, key=_value)
            if here.value - self._low.value >= limit:
                self._is_up, self._high = True, here
        return []  # nothing is dropped: no breath ends here

    def _breath(self, stamp: float, depth: float) -> list[Event]:
        interval_s, self._last = stamp - self._last, stamp
        low, high = at.BREATH_INTERVAL_S
        if not low <= interval_s <= high:
            # The first, or one after a pause: there is no interval between neighbours.
            # nothing is dropped: the breath is told, and has no interval
            self._intervals.clear()
            return []  # nothing is dropped: the breath is told, and has no interval
        self._intervals.append(_Point(stamp, interval_s))
        while self._intervals[0].stamp <= stamp - at.BR_WINDOW_S:
            # nothing is dropped: the window has passed it
            self._intervals.popleft()
        events = [Event("breaths", stamp, (interval_s,)), Event("breath_depth", stamp, (depth,))]
        if len(self._intervals) >= at.BR_LEAST:
            events += self._rate(stamp)
        return events

    def _rate(self, stamp: float) -> list[Event]:
        """Return breaths per minute, from the intervals close to their median, and from all.

        A missed breath doubles an interval, and a cough halves one. A pause doubles one as well,
        which is why the rate from all intervals is returned alongside.
        """
        intervals = [each.value for each in self._intervals]
        middle = median(intervals)
        # nothing is dropped: its quality tells how many are left
        alike = [s for s in intervals if middle / at.BR_ALIKE <= s <= middle * at.BR_ALIKE]
        # With an even number, the median lies between two intervals, and none may be close to it.
        taken = alike or intervals
        covered = min(1.0, math.fsum(taken) / at.BR_WINDOW_S)
        beside = (float(len(taken)), len(taken) / len(intervals), covered, 60 / fmean(intervals))
        return [
            Event("br_live", stamp, (60 / fmean(taken),)),
            Event(BR_QUALITY, stamp, beside),
        ]


def _value(point: _Point) -> float:
    return point.value


class _Usual:
    """Measures the usual span of a signal: the median of its spans in blocks of time.

    Unlike a standard deviation, it does not change with one cough or change of posture. While
    somebody holds the breath, or between slow breaths, the spans are those of noise and of the
    heart; so a share of the larger ones of a longer time is the least.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self._block: list[float] = []
        # nothing is dropped: a memory of spans, not of samples
        self._spans: deque[float] = deque(maxlen=at.BREATH_BLOCKS_LONG)
        self._usual = 0.0

    def take(self, value: float) -> float:
        """Take a value, and return the usual span; 0 before two blocks are full."""
        self._block.append(value)
        if len(self._block) == self._length:
            self._spans.append(max(self._block) - min(self._block))
            self._block.clear()
            if len(self._spans) > 1:
                spans = list(self._spans)
                large = sorted(spans)[3 * len(spans) // 4]
                newest = median(spans[-at.BREATH_BLOCKS :])
                self._usual = max(newest, at.BREATH_LONG_SHARE * large)
        return self._usual


class _Noise:
    """Measures the standard deviation of white noise in a signal, times a factor.

    At most samples, second differences consist of noise; their median ignores the others.
    """

    def __init__(self, length: int, factor: float) -> None:
        # nothing is dropped: a memory of noise, not of samples
        self._bends: deque[float] = deque(maxlen=length)
        self._last: tuple[float, float] | None = None
        self._factor = factor * at.OF_MEDIAN / math.sqrt(6)
        self._count = 0
        self.value = 0.0

    def take(self, value: float) -> None:
        """Take a value."""
        before, last = self._last or (value, value)
        self._last = last, value
        self._bends.append(abs(before - 2 * last + value))
        self._count += 1
        if self._count % _NOISE_EVERY == 0:
            self.value = self._factor * median(self._bends)
