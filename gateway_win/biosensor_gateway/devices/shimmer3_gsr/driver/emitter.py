"""Turns a Shimmer's samples and readings into samples of the declared streams."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite

import numpy as np

from biosensor_gateway.devices.shimmer3_gsr.driver.battery import charge_percent
from biosensor_gateway.devices.shimmer3_gsr.driver.channels import Channel, Layout
from biosensor_gateway.devices.shimmer3_gsr.driver.commands import TICKS_PER_S
from biosensor_gateway.devices.shimmer3_gsr.driver.gsr import (
    Floats,
    conductance_us,
    gsr_ranges,
    millivolts,
)
from biosensor_gateway.devices.shimmer3_gsr.driver.messages import BatteryReading, Packet
from biosensor_gateway.devices.shimmer3_gsr.driver.pulse import PulseDetector
from biosensor_gateway.devices.shimmer3_gsr.driver.timeline import TickTimeline
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
    has_ppg_scale
        Whether the scale of the pulse signal is known; if not, it has no value.
    """

    layout: Layout
    divisor: int
    gsr_setting: int
    has_ppg_scale: bool = True

    @property
    def rate_hz(self) -> float:
        """Sampling rate."""
        return TICKS_PER_S / self.divisor


class ShimmerEmitter:
    """Turns packets into samples; one instance a device, over all its connections."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._log = DeviceLog("biosensor_gateway.shimmer3_gsr", sink.identity)
        self._timeline = TickTimeline()
        self._measurement: Measurement | None = None
        self._newest_arrival_s: float | None = None
        self._measured_until_s: float | None = None
        self._quality: list[float] = []
        self._quality_s = 0.0

    def started(self, measurement: Measurement) -> None:
        """Prepare for packets of a new connection."""
        self._measurement = measurement
        self._timeline.started(measurement.divisor)
        self._gsr_at = measurement.layout.index(Channel.GSR)
        self._ppg_at = measurement.layout.index(Channel.PPG)
        self._pulse = PulseDetector(measurement.rate_hz)
        self._quality = []

    def kept_measuring_until(self, lsl_s: float) -> None:
        """Note that the device went on measuring, as far as one knows, and was not heard.

        What it measured since its last packet is counted as lost, by an estimate, once
        the next packet shows that it was not switched off meanwhile.

        Parameters
        ----------
        lsl_s
            LSL clock when it was given up or stopped.
        """
        self._measured_until_s = lsl_s

    def take(self, packets: Iterable[tuple[Packet, float]]) -> None:
        """Emit the samples of the packets of one read, each with its LSL time of arrival."""
        batch: list[tuple[Packet, float, float]] = []
        for packet, arrival_s in packets:
            placed = self._timeline.place(packet.ticks, arrival_s)
            if placed is None:
                continue
            if self._measured_until_s is not None and not placed.restarted:
                self._count_unheard(self._measured_until_s)
            self._measured_until_s = None
            if placed.restarted:
                self._emit(batch)
                batch = []
                self._sink.restart_clock()
            for data_name in WAVEFORMS if placed.lost else ():
                self._sink.lost(data_name, placed.lost)
            batch.append((packet, placed.time_s, arrival_s))
        self._emit(batch)

    def battery(self, reading: BatteryReading, arrival_s: float) -> None:
        """Emit a battery reading, which has no time of its own."""
        level = charge_percent(reading)
        if level is not None:
            self._sink.emit_at("bat", [level], [arrival_s])

    def _count_unheard(self, until_s: float) -> None:
        if self._measurement is None or self._newest_arrival_s is None:
            return
        count = round((until_s - self._newest_arrival_s) * self._measurement.rate_hz)
        if count > 0:
            for data_name in WAVEFORMS:
                self._sink.lost(data_name, count)
            self._log.warning("samples were lost in a gap", estimated_samples=count)

    def _emit(self, batch: list[tuple[Packet, float, float]]) -> None:
        if not batch or self._measurement is None:
            return
        times = [time_s for _, time_s, _ in batch]
        raw = [packet.values[self._gsr_at] for packet, _, _ in batch]
        setting = self._measurement.gsr_setting
        gsr = conductance_us(raw, setting)
        ppg = millivolts([packet.values[self._ppg_at] for packet, _, _ in batch])
        if not self._measurement.has_ppg_scale:
            ppg = np.full_like(ppg, np.nan)
        self._newest_arrival_s = batch[-1][2]
        self._sink.observe(times[-1], self._newest_arrival_s)
        self._sink.emit("gsr", gsr, times)
        self._sink.emit("ppg", ppg, times)
        self._emit_heart_rate(times, ppg)
        closed = isfinite(gsr[-1])
        self._emit_quality(times[-1], closed, int(gsr_ranges(raw[-1:], setting)[0]))

    def _emit_heart_rate(self, times: list[float], ppg: Floats) -> None:
        for time_s, value in zip(times, ppg.tolist(), strict=True):
            rate = self._pulse.feed(time_s, value) if isfinite(value) else None
            if rate is not None:
                self._sink.emit_value("hr", rate.bpm, rate.time_s)

    def _emit_quality(self, time_s: float, closed: bool, gsr_range: int) -> None:
        quality = [float(closed), float(gsr_range), float(self._pulse.found(time_s))]
        if quality != self._quality or time_s - self._quality_s >= QUALITY_PERIOD_S:
            self._quality, self._quality_s = quality, time_s
            self._sink.emit("quality", [quality], [time_s])
