"""Converts a Shimmer's measurements to samples of the declared streams."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.commands import TICKS_PER_S
from biosensor_gateway.devices.shimmer.driver.exg import electrodes_on
from biosensor_gateway.devices.shimmer.driver.packets import Batch, PacketEmitter
from biosensor_gateway.devices.shimmer.driver.signals import Signal
from biosensor_gateway.devices.sink import Sink

QUALITY_PERIOD_S = 10.0


@dataclass(frozen=True, slots=True)
class Measurement:
    """The setup of a device.

    Attributes
    ----------
    layout
        Layout of the channels in a packet.
    divisor
        The sample rate is 32768 Hz divided by it.
    signals
        Streams in a packet.
    status_at
        Positions of the status of both ExG chips; None without lead-off detection, so there is no
        ``quality``.
    denied
        What the device refuses and why, by data name.
    """

    layout: Layout
    divisor: int
    signals: tuple[Signal, ...]
    status_at: tuple[int, int] | None = None
    denied: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def rate_hz(self) -> float:
        """Sample rate."""
        return TICKS_PER_S / self.divisor

    @property
    def streams(self) -> tuple[str, ...]:
        """Data names of the streams in a packet."""
        return tuple(signal.data_name for signal in self.signals)


@dataclass(slots=True)
class _Told:
    """The last emitted electrode state, and its device time."""

    quality: tuple[float, ...] | None = field(default=None)
    time_s: float = 0.0


class ShimmerEmitter(PacketEmitter):
    """Converts packets to samples; one instance per device, over all its connections."""

    def __init__(self, sink: Sink) -> None:
        super().__init__(sink, "shimmer")
        self._measurement: Measurement | None = None
        self._told = _Told()

    def started(self, measurement: Measurement) -> None:
        """Prepare for packets of a new connection."""
        self._measurement = measurement
        self._expect(measurement.divisor, measurement.streams)
        self._told = _Told()

    def _emit(self, batch: Batch) -> None:
        assert self._measurement is not None
        raw = np.array(batch.rows, np.float64)
        for signal in self._measurement.signals:
            self._sink.emit(signal.data_name, signal.convert(raw[:, signal.at]), batch.times)
        if self._measurement.status_at is not None:
            self._emit_quality(batch, self._measurement.status_at)

    def _emit_quality(self, batch: Batch, status_at: tuple[int, int]) -> None:
        for row, time_s in zip(batch.rows, batch.times, strict=True):
            on = electrodes_on(row[status_at[0]], row[status_at[1]])
            quality = (float(all(on)), *on)
            is_due = time_s - self._told.time_s >= QUALITY_PERIOD_S
            if quality != self._told.quality or is_due:
                self._told = _Told(quality, time_s)
                self._sink.emit("quality", [quality], [time_s])
