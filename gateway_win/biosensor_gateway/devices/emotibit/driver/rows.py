"""Puts the channels of one sensor side by side: each comes in packets of its own.

Packets of a sensor that were read together have the same time, or nearly so, and the same
number of samples. The times are those of *reading*: samples wait for it in the sensor, whose
oscillator is not the processor's. So samples are counted, and `Oscillator` tells when.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import nan
from statistics import linear_regression
from typing import NamedTuple

TOGETHER_S = 0.006
"""Channels of one sensor that were read together are stamped one after another."""
LATE_S = 0.02
"""By so much reading is earlier or later than the count of samples says."""
ROUNDS_KEPT = 4
"""A channel that does not come by then, at ten rounds a second, was lost."""
HOLE_S = 0.5
"""What is missing for longer was lost, whatever the packets' numbers say: a sensor's buffer
was full. For shorter times, reading may have been late."""
ANEW_S = 5.0
"""After a longer hole the line through the times begins anew: where it would have led to is
less certain than the next time of reading."""

# Times of reading are the processor's, in whole milliseconds, and late by up to the 13 ms between
# two looks at the sensor. The oscillator may be a percent off, which is beyond what a `DeviceClock`
# takes for a crystal.
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
        # nothing is dropped: these are times, not samples
        self._points: deque[Point] = deque(maxlen=POINTS)
        # nothing is dropped: nor are these
        self._line: deque[tuple[int, float]] = deque(maxlen=_KEPT)

    def anew(self) -> Oscillator:
        """Return the same one, of a device that was started anew."""
        return Oscillator(self._rate_hz, self._late_s, self._period_s)

    def observe(self, index: int, count: int, read_s: float) -> None:
        """Note when a sample was read, which is behind all before; *count* came with it."""
        if not self._line:
            self._begin(index, count, read_s)
            return  # nothing is dropped: the line begins with it
        read_s -= self._late_s
        before, before_s = self._line[-1]
        expected_s = before_s + (index - before) * self._period_s
        if index - before > count and abs(read_s - expected_s) > AGREES_S:
            self.restart(index, count, read_s + self._late_s)
            return  # nothing is dropped: a new line begins with it
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
            return  # nothing is dropped: a time that the rate needs no point of
        self._points.append((index, read_s))
        if self._span_s > LEAST_S:
            indices, times = zip(*self._points, strict=True)
            period_s = linear_regression(indices, times).slope
            if abs(period_s / self._nominal_s - 1) < TOLERANCE:
                self._period_s = period_s


class Rows(NamedTuple):
    """Samples that are complete, or as complete as they get.

    Attributes
    ----------
    values
        One row a sample, NaN where a channel was lost.
    times_s
        Device time of each.
    lost
        Samples before them of which nothing came.
    """

    values: list[list[float]]
    times_s: list[float]
    lost: int


class SensorRows:
    """The samples of one sensor, over all connections.

    Parameters
    ----------
    rate_hz
        Nominal rate.
    channels
        How many there are.
    oscillator
        That it samples by.
    """

    def __init__(self, rate_hz: float, channels: int, oscillator: Oscillator) -> None:
        self._rate_hz = rate_hz
        self._channels = channels
        self._oscillator = oscillator
        self._rounds: list[tuple[float, int]] = []
        self._last: list[tuple[float, int] | None] = [None] * channels
        self._rows: dict[int, list[float]] = {}
        self._next: int | None = None

    def anew(self) -> SensorRows:
        """Return the same sensor, of a device that was started anew."""
        return SensorRows(self._rate_hz, self._channels, self._oscillator.anew())

    def add(self, channel: int, values: Sequence[float], time_s: float, *, gap: bool) -> None:
        """Take in a packet of one channel.

        Parameters
        ----------
        time_s
            Device time at which it was read, near that of the last value.
        gap
            Whether packets of any kind were lost since the channel's last one.
        """
        own = self._last[channel]
        if own is not None and time_s < own[0]:
            # It was overtaken by the first one of all.
            return  # nothing is dropped: its stream begins with the packet that overtook it
        last = self._place(channel, len(values), time_s, gap=gap)
        self._last[channel] = (time_s, last)
        for index, value in enumerate(values, last - len(values) + 1):
            if self._next is None or index >= self._next:
                self._rows.setdefault(index, [nan] * self._channels)[channel] = value

    def ready(self) -> Rows:
        """Return the samples whose channels have all come, or will not come any more."""
        ready: list[tuple[int, list[float]]] = []
        lost = 0
        too_old = self._rounds[0][1] if len(self._rounds) > ROUNDS_KEPT else None
        for index in sorted(self._rows):
            row = self._rows[index]
            if self._waits(index) and (too_old is None or index > too_old):
                break
            if self._next is not None:
                lost += index - self._next
            self._next = index + 1
            ready.append((index, row))
        for index, _ in ready:
            del self._rows[index]
        times = [self._oscillator.time_s(index) for index, _ in ready]
        return Rows([row for _, row in ready], times, lost)

    def break_off(self) -> None:
        """Give up samples whose other channels will not come, as at the end of a connection."""
        self._rows = {index: row for index, row in self._rows.items() if not self._waits(index)}

    def _waits(self, index: int) -> bool:
        return any(last is None or last[1] < index for last in self._last)

    def _place(self, channel: int, count: int, time_s: float, *, gap: bool) -> int:
        """Return the number of a packet's last sample, counted from the first one of all."""
        for round_s, index in reversed(self._rounds):
            if abs(round_s - time_s) <= TOGETHER_S:
                return index
        index = self._follow(channel, count, time_s, gap=gap)
        if not self._rounds or index > self._rounds[-1][1]:
            # Only the channel that is furthest tells the time: the others have nothing new.
            self._lead(index, count, time_s)
        return index

    def _follow(self, channel: int, count: int, time_s: float, *, gap: bool) -> int:
        """Go on after the channel's own last sample: it may be read a moment after the others."""
        own = self._last[channel]
        if own is not None:
            hole_s = time_s - own[0] - count / self._rate_hz
            if not gap and hole_s <= HOLE_S:
                return own[1] + count
        if not self._rounds:
            return count
        newest_s, newest = self._rounds[-1]
        if abs(time_s - newest_s - count / self._rate_hz) <= LATE_S:
            # Only this channel was lost for a while: the others say where it is.
            return newest + count
        index = self._oscillator.index_at(time_s)
        if own is not None:
            index = max(index, own[1] + count)
        return max(index, newest + 1) if time_s > newest_s else index

    def _lead(self, index: int, count: int, time_s: float) -> None:
        """Have the clock follow the newest sample of all."""
        before_s, before = self._rounds[-1] if self._rounds else (time_s, index - count)
        count = min(count, index - before)
        hole_s = time_s - before_s - count / self._rate_hz
        self._rounds = [*self._rounds[-ROUNDS_KEPT:], (time_s, index)]
        follow = self._oscillator.restart if hole_s > ANEW_S else self._oscillator.observe
        follow(index, count, time_s)
