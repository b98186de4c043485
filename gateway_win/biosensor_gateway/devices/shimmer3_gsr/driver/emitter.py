"""Turns what a GSR+ unit sends into samples of the declared streams."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite

from biosensor_gateway.devices.shimmer.driver.adc import Floats, millivolts
from biosensor_gateway.devices.shimmer.driver.battery import emit_charge
from biosensor_gateway.devices.shimmer.driver.channels import Channel, Layout
from biosensor_gateway.devices.shimmer.driver.commands import TICKS_PER_S
from biosensor_gateway.devices.shimmer.driver.messages import BatteryReading, Packet
from biosensor_gateway.devices.shimmer.driver.packets import Batch, PacketTimes
from biosensor_gateway.devices.shimmer3_gsr.driver.gsr import conductance_us, gsr_ranges
from biosensor_gateway.devices.shimmer3_gsr.driver.pulse import PulseRate
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.system.device_log import DeviceLog

QUALITY_PERIOD_S = 10.0
WAVEFORMS = ("gsr", "ppg")


@dataclass(frozen=True, slots=True)
class Measurement:
    """How a device was set up to measure.

    Attributes
    ----------
    layout
        Order of the channels in a packet.
    divisor
        The sampling rate is 32768 Hz divided by it.
    gsr_setting
        Feedback resistor, 4 for automatic.
    """

    layout: Layout
    divisor: int
    gsr_setting: int

    @property
    def rate_hz(self) -> float:
        """Sampling rate."""
        return TICKS_PER_S / self.divisor


class GsrEmitter:
    """Turns packets into samples; one instance a device, over all its connections."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        log = DeviceLog("biosensor_gateway.shimmer3_gsr", sink.identity)
        self._packets = PacketTimes(sink, log, self._emit)
        self._measurement: Measurement | None = None
        self._quality: list[float] = []
        self._quality_s = 0.0

    def started(self, measurement: Measurement) -> None:
        """Prepare for packets of a new connection."""
        self._measurement = measurement
        self._packets.started(measurement.divisor, WAVEFORMS)
        self._gsr_at = measurement.layout.index(Channel.GSR)
        self._ppg_at = measurement.layout.index(Channel.PPG)
        self._pulse = PulseRate(measurement.rate_hz)
        self._quality = []

    def kept_measuring_until(self, lsl_s: float) -> None:
        """Note that the device measured until then and was not heard; see `PacketTimes`."""
        self._packets.kept_measuring_until(lsl_s)

    def take(self, packets: Iterable[tuple[Packet, float]]) -> None:
        """Emit the samples of the packets of one read, each with its LSL time of arrival."""
        self._packets.take(packets)

    def battery(self, reading: BatteryReading, arrival_s: float) -> None:
        """Emit a battery reading, which has no time of its own."""
        emit_charge(self._sink, reading, arrival_s)

    def _emit(self, batch: Batch) -> None:
        assert self._measurement is not None
        times = batch.times
        raw = [row[self._gsr_at] for row in batch.rows]
        setting = self._measurement.gsr_setting
        gsr = conductance_us(raw, setting)
        ppg = millivolts([row[self._ppg_at] for row in batch.rows])
        self._sink.emit("gsr", gsr, times)
        self._sink.emit("ppg", ppg, times)
        self._emit_heart_rate(times, ppg)
        closed = isfinite(gsr[-1])
        self._emit_quality(times[-1], closed, int(gsr_ranges(raw[-1:], setting)[0]))

    def _emit_heart_rate(self, times: Sequence[float], ppg: Floats) -> None:
        for time_s, value in zip(times, ppg.tolist(), strict=True):
            for rate in self._pulse.feed(time_s, value) if isfinite(value) else ():
                self._sink.emit_value("hr", rate.bpm, rate.time_s)

    def _emit_quality(self, time_s: float, closed: bool, gsr_range: int) -> None:
        quality = [float(closed), float(gsr_range), float(self._pulse.found(time_s))]
        if quality != self._quality or time_s - self._quality_s >= QUALITY_PERIOD_S:
            self._quality, self._quality_s = quality, time_s
            self._sink.emit("quality", [quality], [time_s])
