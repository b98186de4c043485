"""Converts an EmotiBit's packets to samples of the declared streams."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from math import nan
from statistics import linear_regression
from typing import TYPE_CHECKING, NamedTuple

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

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

TOGETHER_S = 0.006
"""Largest difference between timestamps of channels that were read together."""
LATE_S = 0.02
"""Largest deviation of reading times from the sample count."""
BETWEEN_S = 0.025
"""Largest such deviation of a channel that was read with a sample more or less than the others, at
100 Hz. A slower sensor's samples are further apart, so one was lost."""
ROUNDS_KEPT = 4
"""A channel that is missing after this many rounds, at ten per second, was lost."""
HOLE_S = 0.5
"""A longer gap is a loss, whatever the packets' numbers say, because a sensor's buffer was full. In
shorter gaps, reading may have been late."""
AGAIN_S = 5.0
"""After a longer gap, the line through the times restarts, because its extrapolation is less
certain than the next reading time."""

# Reading times are the processor's, in whole milliseconds, and up to 13 ms late, the interval
# between two reads of the sensor. The oscillator may be off by a percent, which is more than a
# `DeviceClock` tolerates.
POINT_EVERY_S = 0.5
POINTS = 120
"""One minute, of which a delay of 13 ms is 200 ppm."""
LEAST_S, SETTLED_S = 5.0, 20.0
"""Before the first time the nominal rate is better, before the second the estimate is rough."""
TOLERANCE = 0.03
FITS_S, FITS_POINTS = 0.02, 8
"""Beyond it, the sensor has another rate if so many reading times deviate no more from a line."""
GAIN, GAIN_SETTLED = 1 / 16, 1 / 64
"""Fraction of its distance by which the line moves towards a new time."""
AGREES_S = 0.02
"""After a gap, the line restarts if it deviates more from the reading time."""
LEAST_STEP = 0.5
"""Smallest step in periods, so that times always ascend."""
_KEPT = 32

Point = tuple[float, float]


class Oscillator:
    """Maps the numbers of samples to device seconds, in pieces of straight lines.

    Parameters
    ----------
    late_s
        Mean delay of reading its samples.
    period_s
        Sample period, if known from before.
    """

    def __init__(self, rate_hz: float, late_s: float, period_s: float = 0.0) -> None:
        self.is_other = False  # Whether the sensor has another rate than the nominal one.
        self._rate_hz, self._late_s = rate_hz, late_s
        self._nominal_s = 1 / rate_hz
        self._period_s = period_s or self._nominal_s
        # nothing is dropped: these are times, not samples
        self._points: deque[Point] = deque(maxlen=POINTS)
        # nothing is dropped: nor are these
        self._line: deque[tuple[int, float]] = deque(maxlen=_KEPT)

    def restarted(self) -> Oscillator:
        """Return a copy for a restarted device, which keeps the period."""
        return Oscillator(self._rate_hz, self._late_s, self._period_s)

    def observe(self, index: int, count: int, read_s: float) -> None:
        """Add the reading time of the newest sample; *count* samples came with it."""
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
        if self.is_other and abs(read_s - expected_s) > AGREES_S:
            gain = 1.0  # The line was wrong until the rate was known.
        end_s = expected_s + gain * (read_s - expected_s)
        if index - before > count:
            self._line.append((index - count, end_s - count * self._period_s))
        least_s = before_s + (index - before) * LEAST_STEP * self._period_s
        self._line.append((index, max(end_s, least_s)))
        self._note(index, read_s)

    def restart(self, index: int, count: int, read_s: float) -> None:
        """Start a new line after a long gap, with the same rate."""
        self._points.clear()
        before, before_s = self._line[-1]
        first_s = read_s - self._late_s - count * self._period_s
        least_s = before_s + (index - count - before) * LEAST_STEP * self._period_s
        self._begin(index, count, read_s + max(0.0, least_s - first_s))

    def index_at(self, read_s: float) -> int:
        """Return the index of the newest sample at a reading time."""
        index, time_s = self._line[-1]
        return index + round((read_s - self._late_s - time_s) / self._period_s)

    def time_s(self, index: int) -> float:
        """Return the time of a sample in device seconds."""
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
            line = linear_regression(indices, times)
            is_other = abs(line.slope / self._nominal_s - 1) >= TOLERANCE
            if is_other:
                wrong_s = (line.slope * at + line.intercept - each for at, each in self._points)
                if len(times) < FITS_POINTS or max(map(abs, wrong_s)) > FITS_S:
                    return  # nothing is dropped: the times are on no line yet
            self.is_other, self._period_s = is_other, line.slope

    @property
    def rate_hz(self) -> float:
        """Present estimate of the rate."""
        return 1 / self._period_s


class Rows(NamedTuple):
    """Samples that are complete, or will not become more complete."""

    values: list[list[float]]  # One row per sample, NaN where a channel was lost.
    times_s: list[float]  # Device time of each sample.
    lost: int  # Number of samples lost completely before them.


class SensorRows:
    """The samples of one sensor, over all connections."""

    def __init__(self, rate_hz: float, channels: int, oscillator: Oscillator) -> None:
        self._rate_hz = rate_hz
        self._channels = channels
        self._oscillator = oscillator
        self._rounds: list[tuple[float, int]] = []
        self._last: list[tuple[float, int] | None] = [None] * channels
        self._apart = [0] * channels
        self._rows: dict[int, list[float]] = {}
        self._next: int | None = None

    @property
    def other_hz(self) -> float | None:
        """The sensor's rate if it is not the nominal one."""
        return self._oscillator.rate_hz if self._oscillator.is_other else None

    def restarted(self) -> SensorRows:
        """Return a copy for a restarted device."""
        return SensorRows(self._rate_hz, self._channels, self._oscillator.restarted())

    def add(self, channel: int, values: Sequence[float], time_s: float, *, gap: bool) -> None:
        """Add a packet of one channel.

        Parameters
        ----------
        time_s
            Device time of reading, near that of the last value.
        gap
            Whether packets of any kind were lost since the channel's last one.
        """
        own = self._last[channel]
        if own is not None and time_s < own[0]:
            # This packet was overtaken by the very first one.
            return  # nothing is dropped: its stream begins with the packet that overtook it
        last = self._place(channel, len(values), time_s, gap=gap)
        self._last[channel] = (time_s, last)
        for index, value in enumerate(values, last - len(values) + 1):
            if self._next is None or index >= self._next:
                self._rows.setdefault(index, [nan] * self._channels)[channel] = value

    def ready(self) -> Rows:
        """Return the samples whose channels have all arrived or are lost."""
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
            # nothing is dropped: they are returned
            del self._rows[index]
        times = [self._oscillator.time_s(index) for index, _ in ready]
        return Rows([row for _, row in ready], times, lost)

    def break_off(self) -> None:
        """Discard incomplete samples, for example at the end of a connection."""
        # nothing is dropped: what is missing is counted by the numbers
        self._rows = {index: row for index, row in self._rows.items() if not self._waits(index)}

    def _waits(self, index: int) -> bool:
        return any(last is None or last[1] < index for last in self._last)

    def _place(self, channel: int, count: int, time_s: float, *, gap: bool) -> int:
        """Return the index of a packet's last sample, counted from the very first one."""
        beside = (at for at_s, at in reversed(self._rounds) if abs(at_s - time_s) <= TOGETHER_S)
        index = next(beside, None)
        if index is None:
            index = self._follow(channel, count, time_s, gap=gap)
        else:
            index = self._beside(index, channel, count, time_s, gap=gap)
        if not self._rounds or index > self._rounds[-1][1]:
            # Only the most advanced channel updates the clock, because the others add nothing new.
            self._lead(index, count, time_s)
        return index

    def _beside(self, index: int, channel: int, count: int, time_s: float, *, gap: bool) -> int:
        """Return the index in a round of other channels, which may have one sample more or less."""
        own = self._last[channel]
        if own is None or gap:
            return index
        follows = own[1] + count
        hole_s = time_s - own[0] - count / self._rate_hz
        self._apart[channel] = self._apart[channel] + 1 if follows != index else 0
        # A channel that stays behind has lost samples.
        is_brief = self._apart[channel] <= ROUNDS_KEPT
        return follows if is_brief and abs(hole_s) <= BETWEEN_S else index

    def _follow(self, channel: int, count: int, time_s: float, *, gap: bool) -> int:
        """Continue after the channel's last sample, which may be read later than the others'."""
        own = self._last[channel]
        if own is not None:
            hole_s = time_s - own[0] - count / self._rate_hz
            if not gap and hole_s <= HOLE_S:
                return own[1] + count
        if not self._rounds:
            return count
        newest_s, newest = self._rounds[-1]
        if abs(time_s - newest_s - count / self._rate_hz) <= LATE_S:
            # Only this channel had a loss, so its place follows from the others.
            return newest + count
        index = self._oscillator.index_at(time_s)
        if own is not None:
            index = max(index, own[1] + count)
        return max(index, newest + 1) if time_s > newest_s else index

    def _lead(self, index: int, count: int, time_s: float) -> None:
        """Update the clock with the newest sample."""
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
"""Thermometers, the best one first; the version of the device determines which exist."""
CHOOSING_S = 0.5
"""Every thermometer of a device sends data within this time."""
# A time this far back means that the clock restarted.
_RESTARTED_MS = 2500
READ_LATE_S = 1 / 150
"""Mean delay of sensors with their own oscillator, which are read 75 times a second; the processor
triggers the others itself."""


class EmotiBitEmitter:
    """Converts packets to streams; one instance per device, over all its connections.

    Parameters
    ----------
    ppg_hz
        Rate of the pulse, which depends on the firmware.
    """

    def __init__(self, sink: DeviceSink, ppg_hz: float) -> None:
        self._sink = sink
        self._order, self._times = InOrder(), PacketTimeline(TIMES_MS)
        self._is_first = False
        self._nominal_hz = {
            "eda": CONDUCTANCE_HZ,
            "ppg": ppg_hz,
            "st": TEMPERATURE_HZ,
            **dict.fromkeys(("acc", "gyro", "mag"), MOTION_HZ),
        }
        self._sensors = {
            # The processor triggers conductance and temperature itself.
            name: _sensor(name, hz, 0.0 if name in ("eda", "st") else READ_LATE_S)
            for name, hz in self._nominal_hz.items()
        }
        self._remarks: dict[str, str] = {}
        self._gaps = 0
        self._gaps_before: dict[str, int] = {}
        self._observed_s: float | None = None
        self._thermometer = ""
        self._first_temperatures: dict[str, list[tuple[Packet, float]]] = {}
        self._battery: float | None = None

    def connected(self) -> None:
        """Prepare for a new connection, with lost packets or a restarted device."""
        self._is_first = True
        self._remarks.clear()
        self.ended()
        for sensor in self._sensors.values():
            sensor.break_off()
        self._gaps += 1

    def ended(self) -> None:
        """Emit packets that wait for lost ones."""
        self._use(self._order.end())

    def take(self, packets: Iterable[Packet], arrival_s: float) -> None:
        """Emit the samples of packets that arrived together."""
        timed = [(each, self._time_s(each)) for each in packets]
        # nothing is dropped: only the clock looks at these
        measured = [time_s for each, time_s in timed if each.tag in _PLACES]
        if measured and (self._observed_s is None or max(measured) > self._observed_s):
            self._observed_s = max(measured)
            self._sink.observe(self._observed_s, arrival_s)
        for packet, time_s in timed:
            before = self._order.left_out
            self._use(self._order.take(packet, time_s))
            if self._order.left_out > before:
                why = "their packet came twice, or after it was counted as lost"
                self._sink.left_out(len(packet.payload), why)

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
        """Return the unwrapped device time; restart if the device restarted."""
        expected_ms = 0.0
        steps = self._times.steps(packet.time_ms, expected_ms, None)
        # The first packet of a connection is never late, since earlier ones were lost.
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
        values = self._numbers(packet)
        if packet.payload and not values:
            self._gaps += 1
            return  # nothing is dropped: the next packet of this channel shows a gap
        gap = self._gaps_before.get(packet.tag, self._gaps) != self._gaps
        self._gaps_before[packet.tag] = self._gaps
        if values:
            self._sensors[data_name].add(channel, values, time_s, gap=gap)

    def _numbers(self, packet: Packet) -> Sequence[float]:
        """Return a packet's values; none if they are not all numbers, whose bytes are counted."""
        values = packet.values()
        if values is None:
            self._sink.dropped_bytes += sum(map(len, packet.payload))
        return values or ()

    def _take_temperature(self, packet: Packet, time_s: float) -> None:
        """Emit the temperature of the best thermometer, once known which ones exist."""
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
        """Emit irregular data."""
        match packet.tag:
            case Tag.HEART_RATE:
                rates = self._numbers(packet)
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
        """Emit the intervals of a packet; the last one ends at the packet's time."""
        intervals = [each / 1000 for each in self._numbers(packet)]
        ends = [time_s - sum(intervals[at + 1 :]) for at in range(len(intervals))]
        self._sink.emit("ibi", [[each] for each in intervals], ends)

    def _tell_battery(self, packet: Packet, time_s: float) -> None:
        values = self._numbers(packet)
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
            self._compare_rate(data_name, sensor.other_hz)

    def _compare_rate(self, data_name: str, other_hz: float | None) -> None:
        text = ""
        if other_hz is not None:
            nominal_hz = self._nominal_hz[data_name]
            text = (
                f"{data_name} is measured {other_hz:.1f} times per second, but its header says "
                f"{nominal_hz:g}; install EmotiBit's original firmware"
            )
        if text != self._remarks.get(data_name, ""):
            self._remarks[data_name] = text
            self._sink.remark(f"rate of {data_name}", text)


def _sensor(data_name: str, rate_hz: float, late_s: float) -> SensorRows:
    channels = len(CHANNELS.get(data_name, ("",)))
    return SensorRows(rate_hz, channels, Oscillator(rate_hz, late_s))


def _count_of_marked(payload: tuple[str, ...]) -> int:
    """Return the number of samples: in pairs of tag and number, or one tag each in old firmware."""
    numbers = [int(text) for text in payload[1::2] if text.isascii() and text.isdigit()]
    return sum(numbers) if numbers else len(payload)
