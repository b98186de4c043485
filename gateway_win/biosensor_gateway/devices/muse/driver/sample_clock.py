"""Determines the sample numbers of packets, and the times of counted samples.

Samples are delayed: a headband collects them for up to 130 ms, and the radio adds more delay. So a
`DeviceClock` follows the earliest ones. The real rate deviates from the nominal one by more than
the `DeviceClock` tolerates for an oscillator: in recordings of an Athena, light was 0.3 % too
fast. So the rate is corrected as soon as the deviation is certain.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from biosensor_common.clocks import PacketTimeline
from biosensor_common.device_clock import DeviceClock

POINT_EVERY_S = 0.5
POINTS = 240
LEAST_POINTS = 10
LATE_S = 0.25
"""Later samples waited for a host that did not read, and say nothing about the rate."""
RATE_LIMIT = 0.02
DEVIATIONS = 3.0
"""The rate is corrected if it differs by this many standard errors."""
LEAST_CHANGE = 100e-6
"""Smaller deviations are within what a `DeviceClock` can follow."""
AHEAD_S = 2.0
"""If numbers are further ahead of the time, the device has restarted its counter."""
AHEAD_SHARE = 0.05

Point = tuple[int, float]
"""Number of a sample, and the time when it was sent [s]."""


class SampleClock:
    """The clock of one stream's samples."""

    def __init__(self, rate_hz: float) -> None:
        self._nominal_s = 1 / rate_hz
        self._period_s = self._nominal_s
        self._anchor: Point = (0, 0.0)
        self._points: deque[Point] = deque(maxlen=POINTS)
        self._bin = -1
        self._clock = DeviceClock()

    @property
    def rate_hz(self) -> float:
        """The best current estimate."""
        return 1 / self._period_s

    def restart(self) -> None:
        """Place the next samples by their time alone, but keep the rate."""
        self._points.clear()
        self._clock = DeviceClock()

    def observe(self, *handed_on: Point, own_delay_s: float = 0.0) -> None:
        """Add the last samples of packets that were sent together.

        The one with the smallest delay counts. For the delay in this computer, see
        :meth:`DeviceClock.observe`.
        """
        index, read_s = min(handed_on, key=lambda each: each[1] - self._counted_s(each[0]))
        counted_s = self._counted_s(index)
        if self._clock.observe(counted_s, read_s, own_delay_s=own_delay_s) is not None:
            self._points.clear()
        if read_s - self._clock.to_lsl(counted_s) > LATE_S:
            return
        if self._keep(index, read_s) and len(self._points) > LEAST_POINTS:
            self._correct(index)

    def times(self, indices: Iterable[int]) -> list[float]:
        """Return the times of samples on the clock of the observations."""
        return self._clock.all_to_lsl([self._counted_s(index) for index in indices])

    def _counted_s(self, index: int) -> float:
        at, at_s = self._anchor
        return at_s + (index - at) * self._period_s

    def _keep(self, index: int, read_s: float) -> bool:
        """Keep the earliest point of each half second; return whether a new half second began."""
        number = math.floor(read_s / POINT_EVERY_S)
        if number != self._bin:
            self._bin = number
            self._points.append((index, read_s))
            return True
        late_s, kept = read_s - self._counted_s(index), self._points[-1] if self._points else None
        if kept is None:
            self._points.append((index, read_s))
        elif late_s < kept[1] - self._counted_s(kept[0]):
            self._points[-1] = (index, read_s)
        return False

    def _correct(self, index: int) -> None:
        # Without the newest half second, which is incomplete.
        period_s, error_s = _slope(list(self._points)[:-1])
        change = period_s / self._period_s - 1
        is_known = abs(change) > DEVIATIONS * error_s / self._nominal_s + LEAST_CHANGE
        if not is_known or abs(period_s / self._nominal_s - 1) > RATE_LIMIT:
            return
        self._anchor = index, self._counted_s(index)
        self._period_s = period_s
        self._clock = DeviceClock()
        for at, read_s in self._points:
            self._clock.observe(self._counted_s(at), read_s)


def _slope(points: Sequence[Point]) -> tuple[float, float]:
    """Return the slope of a straight line through points, and its standard error."""
    count = len(points)
    x_mean = sum(x for x, _ in points) / count
    y_mean = sum(y for _, y in points) / count
    spread = sum((x - x_mean) ** 2 for x, _ in points)
    slope = sum((x - x_mean) * (y - y_mean) for x, y in points) / spread
    residuals = sum((y - y_mean - slope * (x - x_mean)) ** 2 for x, y in points)
    return slope, math.sqrt(residuals / (count - 2) / spread)


class Place(NamedTuple):
    """A packet's place among the samples of its stream."""

    first: int  # Number of its first sample; numbers are consecutive within a series.
    lost: int  # Number of samples missing before it.
    is_again: bool  # Whether it is the first packet of a series, which is placed by time alone.


class PacketSeries:
    """Numbers the packets of one stream, over all connections.

    Parameters
    ----------
    modulus
        Number of different packet numbers.
    """

    def __init__(self, modulus: int, samples: int, rate_hz: float) -> None:
        self._numbers = PacketTimeline(modulus)
        self._samples, self._rate_hz = samples, rate_hz
        self._newest_s: float | None = None
        self._next = 0

    def restart(self) -> None:
        """Expect restarted packet numbers."""
        self._numbers.forget()

    def forget(self) -> None:
        """Expect restarted packet numbers and a restarted clock."""
        self._numbers.forget()
        self._newest_s = None

    def place(self, number: int, time_s: float) -> Place:
        """Determine the place of a packet.

        Parameters
        ----------
        time_s
            Its arrival time, or its creation time on the device's clock.
        """
        passed_s = 0.0 if self._newest_s is None else time_s - self._newest_s
        expected = passed_s * self._rate_hz / self._samples
        steps = self._numbers.steps(number, expected)
        ahead = AHEAD_S * self._rate_hz / self._samples + AHEAD_SHARE * abs(expected)
        is_again = steps is None or steps > expected + ahead
        if is_again or steps is None:
            self._numbers.forget()
            self._numbers.place(number)
            lost = 0 if self._newest_s is None else self._missing(passed_s)
        else:
            self._numbers.place(number, expected)
            lost = (steps - 1) * self._samples
        first = self._next + lost
        self._next = first + self._samples
        self._newest_s = time_s
        return Place(first, lost, is_again)

    def _missing(self, passed_s: float) -> int:
        return max(0, round(passed_s * self._rate_hz) - self._samples)
