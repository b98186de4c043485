"""Converts a device's measurements to samples of the declared streams."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection
from typing import TYPE_CHECKING, NamedTuple

from biosensor_common.clocks import TIMELINE_GAIN
from biosensor_gateway.devices.ble_heart_rate.driver.beats import (
    Beat,
    PlacedBeat,
    StoredBeats,
)
from biosensor_gateway.devices.ble_heart_rate.driver.emitter import (
    NO_INTERVAL_LIMIT_S,
    StrapEmitter,
)
from biosensor_gateway.devices.movesense.driver.protocol import (
    HEART_RATE,
    TEMPERATURE,
    Block,
    Measurement,
    Packet,
    in_g,
    parse_ecg,
    parse_heart_rate,
    parse_temperature,
    parse_vectors,
)
from biosensor_gateway.devices.restart_check import RestartCheck
from biosensor_gateway.system.device_log import DeviceLog

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

QUALITY_PERIOD_S = 1.0

# A packet has the timestamp of its first sample in whole milliseconds. The real rate deviates from
# the nominal one, because the movement sensor has its own oscillator.
RATE_TOLERANCE = 0.15
WINDOW_PACKETS = 256
"""About 20 s, of which the resolution of 1 ms is 50 ppm."""
_SEEN_PACKETS = 64
"""A packet that comes twice does so soon."""
_TURN_MS = 1 << 32


class Placed(NamedTuple):
    """A packet's times on the device's clock."""

    times_s: list[float]  # Device clock of each sample, ascending.
    lost: int  # Number of samples missing before them.


class StampClock:
    """Unwraps 32-bit timestamps, which overflow after 49.7 days."""

    def __init__(self) -> None:
        self._newest_ms: int | None = None

    def read(self, stamp_ms: int) -> float:
        """Return the device's time in seconds; packets may be late by up to half the range."""
        if self._newest_ms is None:
            self._newest_ms = stamp_ms
            return stamp_ms / 1000
        ahead = (stamp_ms - self._newest_ms + _TURN_MS // 2) % _TURN_MS - _TURN_MS // 2
        read_ms = self._newest_ms + ahead
        self._newest_ms = max(self._newest_ms, read_ms)
        return read_ms / 1000

    def forget(self) -> None:
        """Restart with the next timestamp."""
        self._newest_ms = None


class PacketSeries:
    """Assigns times to the packets of one measurement, over restarts and connections.

    Sample times are counted at the rate of the last 20 s. Timestamps correct them only slowly, so
    that their rounding has no visible effect.

    Parameters
    ----------
    nominal_hz
        Requested sample rate.
    """

    def __init__(self, nominal_hz: float) -> None:
        self._nominal_hz = nominal_hz
        self._nominal_s = 1 / nominal_hz
        # nothing is dropped: these are stamps of packets that have been emitted
        self._stamps: deque[tuple[int, float]] = deque(maxlen=WINDOW_PACKETS)
        self._index = 0
        self._next_s: float | None = None
        self._is_new = True
        self._packets = 0

    def restart(self) -> None:
        """Expect a new series of packets, which may start at any time after the previous one."""
        self._is_new = True

    def restarted(self) -> PacketSeries:
        """Return an empty series, for a device that restarted its clock."""
        return PacketSeries(self._nominal_hz)

    def place(self, stamp_s: float, count: int) -> Placed:
        """Assign times to the next packet.

        Parameters
        ----------
        stamp_s
            Device time of its first sample.
        count
            Number of its samples, at least one.
        """
        period_s = self._period_s
        expected_s = stamp_s if self._next_s is None else self._next_s
        lost = self._missing(stamp_s - expected_s, count, period_s)
        expected_s += lost * period_s
        if self._is_new or abs(stamp_s - expected_s) > count * period_s / 2:
            # nothing is dropped: these are times, for the rate
            self._stamps.clear()
            self._packets, self._is_new = 0, False
            first_s = stamp_s
        else:
            self._packets += 1
            gain = max(TIMELINE_GAIN, 1 / (1 + self._packets))
            first_s = expected_s + gain * (stamp_s - expected_s)
        self._index += lost
        self._stamps.append((self._index, stamp_s))
        self._index += count
        period_s = self._period_s
        self._next_s = first_s + count * period_s
        return Placed([first_s + at * period_s for at in range(count)], lost)

    def _missing(self, late_s: float, count: int, period_s: float) -> int:
        # Within a series whole packets are lost; at its start only the time shows what is missing.
        unit = 1 if self._is_new else count
        return max(0, round(late_s / (unit * period_s))) * unit

    @property
    def _period_s(self) -> float:
        if len(self._stamps) < 2:
            return self._nominal_s
        (first, first_s), (last, last_s) = self._stamps[0], self._stamps[-1]
        period_s = (last_s - first_s) / (last - first)
        is_likely = abs(period_s / self._nominal_s - 1) <= RATE_TOLERANCE
        return period_s if is_likely else self._nominal_s


class MovesenseEmitter:
    """Converts packets to samples; one instance per device, over all its connections."""

    def __init__(self, sink: DeviceSink, silent: Collection[str]) -> None:
        # Emitter for what all heart-rate straps have: battery, signal strength.
        self.strap = StrapEmitter(sink)
        # Log of the device; its once-only messages appear once, not once per connection.
        self.log = DeviceLog("biosensor_gateway.movesense", sink.identity)
        # Data names that the settings switch off; some share a packet with wanted streams.
        self.silent = silent
        self._sink = sink
        self._clock = StampClock()
        self._series: dict[str, PacketSeries] = {}
        self._beats = StoredBeats()
        self._restarts = RestartCheck(sink)
        # nothing is dropped: these are remembered, not held back
        self._seen: deque[tuple[str, bytes]] = deque(maxlen=_SEEN_PACKETS)
        self._beat_s: float | None = None
        self._searched_from_s: float | None = None
        self._quality_s = -math.inf

    def reconnected(self) -> None:
        """Prepare for a new connection of the same device."""
        self.strap.reconnected()
        self._emit_beats(self._beats.restart())
        self._restarts.reconnected()
        self._beat_s = self._searched_from_s = None

    def started(self, measurement: Measurement) -> None:
        """Prepare for the first packet of a measurement that is about to be started."""
        if measurement.rate_hz is not None:
            series = self._series.setdefault(measurement.path, PacketSeries(measurement.rate_hz))
            series.restart()

    def granted(self, measurement: Measurement) -> None:
        """Note that the device has accepted a measurement."""
        if measurement is HEART_RATE:
            self._searched_from_s = self._sink.clock()

    def take(self, measurement: Measurement, packet: Packet) -> None:
        """Emit the samples of a packet; an invalid one is counted and dropped."""
        if measurement is HEART_RATE:
            is_readable = self._heart_rate(packet)
        elif measurement is TEMPERATURE:
            is_readable = self._temperature(measurement, packet)
        else:
            is_readable = self._block(measurement, packet)
        if not is_readable:
            self._sink.dropped_bytes += len(packet.payload)
            start = packet.payload[:10].hex()
            self.log.warn_once("packets are dropped", path=measurement.path, start=start)
            return
        self._sink.heard()
        self._quality(packet.arrival_s)

    def _block(self, measurement: Measurement, packet: Packet) -> bool:
        is_ecg = "ecg" in measurement.streams
        block = (
            parse_ecg(packet.payload, measurement.sample_bytes)
            if is_ecg
            else parse_vectors(packet.payload, len(measurement.streams))
        )
        if block is None:
            return False
        if not self._came_before(measurement, packet, block.samples.shape[1]):
            self._regular(measurement, block, packet.arrival_s)
        return True

    def _came_before(self, measurement: Measurement, packet: Packet, samples: int) -> bool:
        """Leave out a packet that is one of the last ones again, with its timestamp."""
        seen = (measurement.path, packet.payload)
        if seen not in self._seen:
            self._seen.append(seen)
            return False
        wanted = [name for name in measurement.streams if name not in self.silent]
        self._sink.left_out(samples * len(wanted), "their packet came twice")
        return True

    def _regular(self, measurement: Measurement, block: Block, arrival_s: float) -> None:
        stamp_s = self._device_s(block.stamp_ms, arrival_s)
        count = block.samples.shape[1]
        placed = self._series[measurement.path].place(stamp_s, count)
        self._sink.observe(placed.times_s[-1], arrival_s, measurement.path)
        if placed.lost:
            # nothing is dropped: `lost` counts them below
            self.log.warning(
                "samples were lost", data=measurement.streams, count=placed.lost, estimated=True
            )
        for name, samples in zip(measurement.streams, block.samples, strict=True):
            if name not in self.silent:
                self._sink.lost(name, placed.lost)
                values = in_g(samples) if name == "acc" else samples
                self._sink.emit(name, values, placed.times_s)

    def _heart_rate(self, packet: Packet) -> bool:
        measured = parse_heart_rate(packet.payload)
        if measured is None:
            return False
        if measured.bpm:
            self._sink.emit_on_arrival("hr", measured.bpm, packet.arrival_s)
        beats = [Beat(interval_ms / 1000) for interval_ms in measured.intervals_ms]
        if any(measured.intervals_ms):
            self._beat_s = packet.arrival_s
        placed = self._beats.place(beats, packet.arrival_s)
        self._emit_beats(placed)
        if placed and self._beats.is_placed_by_arrival:
            self._sink.note_arrival("ibi", packet.arrival_s, len(placed))
        return True

    def _temperature(self, measurement: Measurement, packet: Packet) -> bool:
        measured = parse_temperature(packet.payload)
        if measured is None:
            return False
        if self._came_before(measurement, packet, 1):
            return True
        stamp_ms, celsius = measured
        stamp_s = self._device_s(stamp_ms, packet.arrival_s)
        self._sink.observe(stamp_s, packet.arrival_s, TEMPERATURE.path)
        self._sink.emit_value("temp", celsius, stamp_s)
        return True

    def _device_s(self, stamp_ms: int, arrival_s: float) -> float:
        """Unwrap a timestamp; the first one of a connection shows whether the clock restarted."""
        stamp_s = self._clock.read(stamp_ms)
        if self._restarts.counts_again(stamp_s, arrival_s):
            self.log.info("the device was switched off, and its count started again")
            self._series = {path: each.restarted() for path, each in self._series.items()}
            self._clock.forget()
            stamp_s = self._clock.read(stamp_ms)
            self._sink.restart_clock()
        return stamp_s

    def _quality(self, now_s: float) -> None:
        """Emit about once a second whether a beat was detected recently, as a contact signal."""
        # The device itself does not report contact. Nothing is emitted while this is unknown: if
        # the device does not detect beats, or has had no time to find one.
        last_s = self._searched_from_s if self._beat_s is None else self._beat_s
        if last_s is None or now_s - self._quality_s < QUALITY_PERIOD_S:
            return  # nothing is dropped: it says nothing more often
        in_contact = now_s - last_s <= NO_INTERVAL_LIMIT_S
        if in_contact and self._beat_s is None:
            return  # nothing is dropped: nobody knows yet
        self._quality_s = now_s
        self._sink.emit_at("quality", [[float(in_contact)]], [now_s])

    def _emit_beats(self, placed: list[PlacedBeat]) -> None:
        for beat, time_s in placed:
            self._sink.emit_at("ibi", [beat.interval_s], [time_s])
