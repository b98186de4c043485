"""Turns the packets of an EmotiBit into samples of the declared streams."""

from __future__ import annotations

from collections.abc import Iterable

from biosensor_common.clocks import PacketTimeline
from biosensor_gateway.devices.emotibit.declaration import (
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
from biosensor_gateway.devices.emotibit.driver.rows import Oscillator, SensorRows
from biosensor_gateway.devices.sink import Sink

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
"""A time so far behind is of a clock that was started anew."""
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
        """Return the device's time, over roll-overs; begin anew where the device did."""
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
        self._sensors = {name: sensor.anew() for name, sensor in self._sensors.items()}
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
