"""Follows the oscillator of a sensor by the times at which its samples were read.

The times are of the processor, in whole milliseconds, and late by up to the 13 ms between two
looks at the sensor. The oscillator may be a percent off, which is beyond what a
:class:`~biosensor_common.device_clock.DeviceClock` takes for a crystal.
"""

from __future__ import annotations

from collections import deque
from statistics import linear_regression

POINT_EVERY_S = 0.5
POINTS = 120
"""A minute: lateness of 13 ms is 200 ppm of that."""
LEAST_S, SETTLED_S = 5.0, 20.0
"""Before that the nominal rate is nearer, and before this the one found is only about right."""
TOLERANCE = 0.03
GAIN, GAIN_SETTLED = 1 / 16, 1 / 64
"""Which share of its distance the line moves to a time."""
AGREES_S = 0.02
"""Behind a gap, a line that is further from the time of reading begins anew there."""
LEAST_STEP = 0.5
"""Of a period: times never turn back."""
_KEPT = 32

Point = tuple[float, float]


class Oscillator:
    """Maps the numbers of samples to device seconds, in pieces of straight lines.

    Parameters
    ----------
    rate_hz
        Nominal.
    late_s
        By how much its samples are read late, in the mean.
    period_s
        Between two samples, where that is known from before.
    """

    def __init__(self, rate_hz: float, late_s: float, period_s: float = 0.0) -> None:
        self._rate_hz, self._late_s = rate_hz, late_s
        self._nominal_s = 1 / rate_hz
        self._period_s = period_s or self._nominal_s
        self._points: deque[Point] = deque(maxlen=POINTS)
        self._line: deque[tuple[int, float]] = deque(maxlen=_KEPT)

    def anew(self) -> Oscillator:
        """Return the same one, of a device that was started anew."""
        return Oscillator(self._rate_hz, self._late_s, self._period_s)

    def observe(self, index: int, count: int, read_s: float) -> None:
        """Note when a sample was read, which is behind all before; *count* came with it."""
        if not self._line:
            self._begin(index, count, read_s)
            return
        read_s -= self._late_s
        before, before_s = self._line[-1]
        expected_s = before_s + (index - before) * self._period_s
        if index - before > count and abs(read_s - expected_s) > AGREES_S:
            self.restart(index, count, read_s + self._late_s)
            return
        gain = GAIN_SETTLED if self._span_s > SETTLED_S else GAIN
        end_s = expected_s + gain * (read_s - expected_s)
        if index - before > count:
            self._line.append((index - count, end_s - count * self._period_s))
        least_s = before_s + (index - before) * LEAST_STEP * self._period_s
        self._line.append((index, max(end_s, least_s)))
        self._note(index, read_s)

    def restart(self, index: int, count: int, read_s: float) -> None:
        """Begin a new line after a long hole; the rate is the same."""
        self._points.clear()
        before, before_s = self._line[-1]
        first_s = read_s - self._late_s - count * self._period_s
        least_s = before_s + (index - count - before) * LEAST_STEP * self._period_s
        self._begin(index, count, read_s + max(0.0, least_s - first_s))

    def index_at(self, read_s: float) -> int:
        """Return which sample was the newest at a time of reading."""
        index, time_s = self._line[-1]
        return index + round((read_s - self._late_s - time_s) / self._period_s)

    def time_s(self, index: int) -> float:
        """Return when a sample was measured, in device seconds."""
        after = self._line[0]
        for each in reversed(self._line):
            if each[0] <= index:
                if each is self._line[-1]:
                    after = each
                    break
                share = (index - each[0]) / (after[0] - each[0])
                return each[1] + share * (after[1] - each[1])
            after = each
        return after[1] + (index - after[0]) * self._period_s

    @property
    def _span_s(self) -> float:
        return self._points[-1][1] - self._points[0][1] if self._points else 0.0

    def _begin(self, index: int, count: int, read_s: float) -> None:
        read_s -= self._late_s
        self._line.append((index - count, read_s - count * self._period_s))
        self._line.append((index, read_s))
        self._points.append((index, read_s))

    def _note(self, index: int, read_s: float) -> None:
        if self._points and read_s < self._points[-1][1] + POINT_EVERY_S:
            return
        self._points.append((index, read_s))
        if self._span_s > LEAST_S:
            indices, times = zip(*self._points, strict=True)
            period_s = linear_regression(indices, times).slope
            if abs(period_s / self._nominal_s - 1) < TOLERANCE:
                self._period_s = period_s
