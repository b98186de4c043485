"""Turns the packets of an EmotiBit into samples of the declared streams."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from math import nan
from statistics import linear_regression
from typing import NamedTuple

from biosensor_common.clocks import PacketTimeline
from biosensor_gateway.devices.emotibit import (
    CONDUCTANCE_HZ,
    MOTION_HZ,
    TEMPERATURE_HZ,
)
from biosensor_gateway.devices.emotibit.driver.protocol import (
    TIMES_MS,
    InOrder,
    Ordered,
    Packet,
    Tag,
)
from biosensor_gateway.devices.sink import Sink

TOGETHER_S = 0.006
"""Channels of one sensor that were read together are stamped one after another."""
LATE_S = 0.02
"""By so much reading is earlier or later than the count of samples says."""
ROUNDS_KEPT = 4
"""A channel that does not come by then, at ten rounds a second, was lost."""
HOLE_S = 0.5
"""What is missing for longer was lost, whatever the packets' numbers say: a sensor's buffer
was full. For shorter times, reading may have been late."""
AGAIN_S = 5.0
"""After a longer hole the line through the times begins again: where it would have led to is
less certain than the next time of reading."""

# Times of reading are the processor's, in whole milliseconds, and late by up to the 13 ms between
# two looks at the sensor. The oscillator may be a percent off, which is beyond what a `DeviceClock`
# takes for an oscillator.
POINT_EVERY_S = 0.5
POINTS = 120
"""A minute: lateness of 13 ms is 200 ppm of that."""
LEAST_S, SETTLED_S = 5.0, 20.0
"""Before that the nominal rate is nearer, and before this the one found is only about right."""
TOLERANCE = 0.03
GAIN, GAIN_SETTLED = 1 / 16, 1 / 64
"""Which share of its distance the line moves to a time."""
AGREES_S = 0.02
"""Behind a gap, a line that is further from the time of reading begins again there."""
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

    def restarted(self) -> Oscillator:
        """Return the same one, of a device that was started again."""
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

    def restarted(self) -> SensorRows:
        """Return the same sensor, of a device that was started again."""
        return SensorRows(self._rate_hz, self._channels, self._oscillator.restarted())

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
        follow = self._oscillator.restart if hole_s > AGAIN_S else self._oscillator.observe
        follow(index, count, time_s)


CHANNELS = {
    "eda": (Tag.EDA,),
    "ppg": (Tag.PPG_INFRARED, Tag.PPG_RED, Tag.PPG_GREEN),
    "acc": (Tag.ACC_X, Tag.ACC_Y, Tag.ACC_Z),
    "gyro": (Tag.GYRO_X, Tag.GYRO_Y, Tag.GYRO_Z),
    "mag": (Tag.MAG_X, Tag.MAG_Y, Tag.MAG_Z),
}
_PLACES = {
    tag.value: (data_name, channel)
    for data_name, tags in CHANNELS.items()
    for channel, tag in enumerate(tags)
}
THERMOMETERS = (Tag.THERMOPILE.value, Tag.TEMPERATURE_1.value, Tag.TEMPERATURE_0.value)
"""The best one first; which there are depends on the version of the device."""
CHOOSING_S = 0.5
"""All that a device has come within this time."""
_RESTARTED_MS = 2500
"""A time so far behind is of a clock that was started again."""
READ_LATE_S = 1 / 150
"""Sensors with an oscillator of their own are read 75 times a second; the processor itself has
the others measure."""


class EmotiBitEmitter:
    """Turns packets into streams; one instance a device, over all its connections.

    Parameters
    ----------
    ppg_hz
        Rate of the pulse, which depends on the firmware.
    """

    def __init__(self, sink: Sink, ppg_hz: float) -> None:
        self._sink = sink
        self._sensors = {
            "eda": _sensor("eda", CONDUCTANCE_HZ, 0.0),
            "ppg": _sensor("ppg", ppg_hz, READ_LATE_S),
            "st": _sensor("st", TEMPERATURE_HZ, 0.0),
            **{name: _sensor(name, MOTION_HZ, READ_LATE_S) for name in ("acc", "gyro", "mag")},
        }
        self._order, self._times = InOrder(), PacketTimeline(TIMES_MS)
        self._is_first = False
        self._gaps = 0
        self._gaps_before: dict[str, int] = {}
        self._observed_s: float | None = None
        self._thermometer = ""
        self._first_temperatures: dict[str, list[tuple[Packet, float]]] = {}
        self._battery: float | None = None

    def connected(self) -> None:
        """Expect packets to have been lost since the last one, or the device to have restarted."""
        self._is_first = True
        self.ended()
        for sensor in self._sensors.values():
            sensor.break_off()
        self._gaps += 1

    def ended(self) -> None:
        """Emit what still waits for a packet that will not come any more."""
        self._use(self._order.end())

    def take(self, packets: Iterable[Packet], arrival_s: float) -> None:
        """Emit the samples of packets that arrived together.

        Parameters
        ----------
        arrival_s
            LSL clock at their arrival.
        """
        timed = [(each, self._time_s(each)) for each in packets]
        measured = [time_s for each, time_s in timed if each.tag in _PLACES]
        if measured and (self._observed_s is None or max(measured) > self._observed_s):
            self._observed_s = max(measured)
            self._sink.observe(self._observed_s, arrival_s)
        for packet, time_s in timed:
            self._use(self._order.take(packet, time_s))

    def _use(self, packets: Iterable[Ordered]) -> None:
        for packet, time_s, is_behind_gap in packets:
            self._gaps += is_behind_gap
            if packet.tag in _PLACES:
                self._add(*_PLACES[packet.tag], packet, time_s)
            elif packet.tag in THERMOMETERS:
                self._take_temperature(packet, time_s)
            elif self._observed_s is not None:
                self._tell(packet, time_s)
        if self._observed_s is not None:
            self._emit()

    def _time_s(self, packet: Packet) -> float:
        """Return the device's time, over roll-overs; begin again where the device did."""
        expected_ms = 0.0
        steps = self._times.steps(packet.time_ms, expected_ms, None)
        # What is late came before the connection was lost, so the first packet is never late.
        limit, self._is_first = (0 if self._is_first else -_RESTARTED_MS), False
        if steps is not None and steps < limit:
            self._restart()
            steps = None
        if steps is None or steps > 0:
            self._times.place(packet.time_ms, expected_ms, None)
            return (self._times.newest or 0) / 1000
        return ((self._times.newest or 0) + steps) / 1000

    def _restart(self) -> None:
        self.ended()
        self._sink.restart_clock()
        self._observed_s = None
        self._sensors = {name: sensor.restarted() for name, sensor in self._sensors.items()}
        self._first_temperatures.clear()
        self._times.forget()

    def _add(self, data_name: str, channel: int, packet: Packet, time_s: float) -> None:
        values = packet.values()
        if values is None:
            # The next one of this channel shows a hole, which is counted.
            self._sink.dropped_bytes += sum(map(len, packet.payload))
            self._gaps += 1
            return
        gap = self._gaps_before.get(packet.tag, self._gaps) != self._gaps
        self._gaps_before[packet.tag] = self._gaps
        if values:
            self._sensors[data_name].add(channel, values, time_s, gap=gap)

    def _take_temperature(self, packet: Packet, time_s: float) -> None:
        """Pass on the temperature of the best thermometer, once it is known which there are."""
        if self._thermometer:
            if packet.tag == self._thermometer:
                self._add("st", 0, packet, time_s)
            return  # nothing is dropped: the other thermometer is chosen once and for all
        self._first_temperatures.setdefault(packet.tag, []).append((packet, time_s))
        if time_s - min(first[0][1] for first in self._first_temperatures.values()) >= CHOOSING_S:
            self._thermometer = min(self._first_temperatures, key=THERMOMETERS.index)
            for each, at_s in self._first_temperatures.pop(self._thermometer):
                self._add("st", 0, each, at_s)

    def _tell(self, packet: Packet, time_s: float) -> None:
        """Pass on what comes now and then."""
        match packet.tag:
            case Tag.HEART_RATE:
                rates = packet.values() or ()
                self._sink.emit("hr", [[each] for each in rates], [time_s] * len(rates))
            case Tag.INTERVAL:
                self._tell_intervals(packet, time_s)
            case Tag.BATTERY_PERCENT:
                self._tell_battery(packet, time_s)
            case Tag.CLIPPING | Tag.OVERFLOW:
                count = float(_count_of_marked(packet.payload))
                is_clipping = packet.tag == Tag.CLIPPING
                row = [count, 0.0] if is_clipping else [0.0, count]
                self._sink.emit("quality", [row], [time_s])
            case _:
                return  # nothing is dropped: packets of other kinds are no samples

    def _tell_intervals(self, packet: Packet, time_s: float) -> None:
        """Several intervals of one packet end one after another, the last one at its time."""
        intervals = [each / 1000 for each in packet.values() or ()]
        if intervals and min(intervals) > 0:
            ends = [time_s - sum(intervals[at + 1 :]) for at in range(len(intervals))]
            self._sink.emit("ibi", [[each] for each in intervals], ends)

    def _tell_battery(self, packet: Packet, time_s: float) -> None:
        values = packet.values()
        if values and values[-1] != self._battery:
            self._battery = values[-1]
            self._sink.emit_value("bat", self._battery, time_s)

    def _emit(self) -> None:
        for data_name, sensor in self._sensors.items():
            rows = sensor.ready()
            if rows.values:
                self._sink.emit(data_name, rows.values, rows.times_s)
            if rows.lost:
                self._sink.lost(data_name, rows.lost)


def _sensor(data_name: str, rate_hz: float, late_s: float) -> SensorRows:
    channels = len(CHANNELS.get(data_name, ("",)))
    return SensorRows(rate_hz, channels, Oscillator(rate_hz, late_s))


def _count_of_marked(payload: tuple[str, ...]) -> int:
    """Count samples: a tag and its number each, or of older firmware a tag for each sample."""
    numbers = [int(text) for text in payload[1::2] if text.isascii() and text.isdigit()]
    return sum(numbers) if numbers else len(payload)
