"""Puts the channels of one sensor side by side: each comes in packets of its own.

Packets of a sensor that were read together have the same time, or nearly so, and the same
number of samples. The times are those of *reading*: samples wait for it in the sensor, whose
oscillator is not the processor's. So samples are counted, and `Oscillator` tells when.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import NamedTuple

from biosensor_gateway.devices.emotibit.driver.oscillator import Oscillator

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
            return
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
