"""Converts an optical sensor's data to samples of the declared streams."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import nan

from biosensor_gateway.devices.ble_heart_rate.driver.beats import (
    Beat,
    PlacedBeat,
    StoredBeats,
    walk_back,
)
from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.polar_h10.driver.emitter import PolarEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import PulseInterval, PulseIntervals
from biosensor_gateway.devices.sink import Sink

DATA_NAMES: Mapping[Measurement, str] = {
    Measurement.PPG: "ppg",
    Measurement.ACCELERATION: "acc",
    Measurement.GYROSCOPE: "gyro",
    Measurement.MAGNETOMETER: "mag",
    Measurement.PULSE_INTERVALS: "ppi",
}
"""Data names of the declared streams by measurement."""
DOUBTED = frozenset({Measurement.PPG})
"""Measurements with a doubtful rate: a Verity Sense reported 135 Hz and sent 55 [1]_.

.. [1] Polar BLE SDK, documentation/KnownIssues.md, Polar Verity Sense, issue 1.
"""
GATHER_S = 0.3
"""Intervals that do not fit into one frame come in several frames in quick succession."""
_NS = 1e9
# Timestamp of intervals without a time.
_NOT_LOCATED = 0


class OpticalEmitter(PolarEmitter):
    """Converts frames and heart rates to samples; one instance per device.

    Pulse intervals come in batches and usually without a timestamp. Like a strap's intervals, they
    are placed backwards from the arrival of the batch, which ends when other data arrive.
    Intervals that the device flags as disturbed by movement are left out, but their duration
    counts. The contact flag is ignored, because its vendor calls it unreliable.
    """

    def __init__(self, sink: Sink) -> None:
        strap = StrapEmitter(sink, quality=self._quality, trusts_contact=False)
        super().__init__(sink, DATA_NAMES, strap=strap, doubted=DOUBTED)
        self.on_intervals = self._intervals
        self._beats = _Beats()
        self._batch: list[PulseInterval] = []
        self._batch_s = 0.0
        self._moving = nan

    def reconnected(self) -> None:
        """Prepare for a new connection of the same device."""
        super().reconnected()
        self._end_batch()
        self._emit_placed(self._beats.restart())
        self._moving = nan

    def frame(self, data: bytes, arrival_s: float) -> None:
        """Emit the samples of a frame, and complete batches; see :class:`PolarEmitter`."""
        if arrival_s - self._batch_s > GATHER_S:
            self._end_batch()
        super().frame(data, arrival_s)

    def _quality(self, in_contact: bool) -> Sequence[float]:
        # A heart rate arrives after all frames of a batch.
        self._end_batch()
        return [float(in_contact), self._moving]

    def _intervals(self, frame: PulseIntervals, arrival_s: float) -> None:
        if not frame.intervals:
            return  # nothing is dropped: there is nothing in it
        self._moving = float(any(each.moved for each in frame.intervals))
        stamp_ns = frame.header.timestamp_ns
        if stamp_ns == _NOT_LOCATED or not self.clock_runs:
            self._batch += frame.intervals
            self._batch_s = arrival_s
            return  # nothing is dropped: `_batch` keeps it until it has a time
        # These frames are seconds late, so they are not used for the device's clock.
        lengths_s = [each.interval_ms / 1000 for each in frame.intervals]
        for each, time_s in zip(frame.intervals, walk_back(stamp_ns / _NS, lengths_s), strict=True):
            if _counts(each):
                self._sink.emit("ppi", [_sample(each)], [time_s])

    def _end_batch(self) -> None:
        batch, self._batch = self._batch, []
        if batch:
            self._emit_placed(self._beats.place(batch, self._batch_s))

    def _emit_placed(self, placed: Sequence[tuple[PulseInterval, float]]) -> None:
        for each, time_s in placed:
            if _counts(each):
                self._sink.emit_at("ppi", [_sample(each)], [time_s])


class _Beats:
    """Places intervals by their lengths, and keeps their other data."""

    def __init__(self) -> None:
        self._stored = StoredBeats(holds_first=False)
        self._waiting: list[PulseInterval] = []

    def place(
        self, intervals: Sequence[PulseInterval], arrival_s: float
    ) -> list[tuple[PulseInterval, float]]:
        """Add intervals; return those placed now, in order, with LSL times [s]."""
        self._waiting += intervals
        beats = [Beat(each.interval_ms / 1000) for each in intervals]
        return self._named(self._stored.place(beats, arrival_s))

    def restart(self) -> list[tuple[PulseInterval, float]]:
        """Restart; return the intervals held back."""
        return self._named(self._stored.restart())

    def _named(self, placed: Sequence[PlacedBeat]) -> list[tuple[PulseInterval, float]]:
        named = list(zip(self._waiting, (each.time_s for each in placed), strict=False))
        del self._waiting[: len(named)]
        return named


def _counts(interval: PulseInterval) -> bool:
    return interval.interval_ms > 0 and not interval.moved


def _sample(interval: PulseInterval) -> list[float]:
    return [interval.interval_ms / 1000, interval.error_ms / 1000]
