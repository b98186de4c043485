"""Converts a heart-rate strap's values to samples of the declared streams."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from biosensor_gateway.devices.ble_heart_rate.driver.beats import (
    Beat,
    PlacedBeat,
    StoredBeats,
)
from biosensor_gateway.devices.ble_heart_rate.driver.protocol import (
    HeartRateMeasurement,
    parse_battery_level,
    parse_measurement,
)

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

NO_INTERVAL_LIMIT_S = 5.0
"""A beating heart produces an interval within this time."""


def _contact_alone(in_contact: bool) -> Sequence[float]:
    return [float(in_contact)]


class StrapEmitter:
    """Converts characteristic values to samples; one instance per device, over all connections.

    Straps send no timestamps: samples get their arrival time, and beats are placed before it by
    their intervals.

    Parameters
    ----------
    quality
        Creates a ``quality`` sample from the skin contact.
    trusts_contact
        Expect no heart rate while there is no skin contact.
    """

    def __init__(
        self,
        sink: DeviceSink,
        *,
        quality: Callable[[bool], Sequence[float]] = _contact_alone,
        trusts_contact: bool = True,
    ) -> None:
        self._sink = sink
        self._quality = quality
        self._trusts_contact = trusts_contact
        self._beats = StoredBeats()
        self._sends_intervals = False
        self._interval_seen_s: float | None = None
        # The device sends better intervals by other means, so those of the heart rate measurement
        # are ignored.
        self.has_better_intervals = False

    def reconnected(self) -> None:
        """Prepare for a new connection of the same device."""
        self._emit(self._beats.restart())
        self._interval_seen_s = None

    def measurement(self, data: bytes, arrival_s: float) -> None:
        """Emit ``hr``, ``ibi`` and ``quality`` from a Heart Rate Measurement."""
        measured = parse_measurement(data)
        if measured is None:
            self._sink.dropped_bytes += len(data)
            return
        self._sink.heard("hr")
        if measured.bpm:
            self._sink.emit_on_arrival("hr", measured.bpm, arrival_s)
        self._intervals(measured, arrival_s)
        in_contact = self._in_contact(measured, arrival_s)
        if not in_contact and self._trusts_contact:
            # Some straps stop measuring while they are not worn.
            self._sink.excuse("hr")
        self._sink.emit_at("quality", [self._quality(in_contact)], [arrival_s])

    def battery(self, data: bytes, arrival_s: float) -> None:
        """Emit ``bat`` from a Battery Level."""
        percent = parse_battery_level(data)
        if percent is not None:
            self._sink.emit_at("bat", [percent], [arrival_s])

    def signal_strength(self, rssi_dbm: int | None, time_s: float) -> None:
        """Emit ``rssi``, which is only known before the connection; None if unknown."""
        if rssi_dbm is not None:
            self._sink.emit_at("rssi", [rssi_dbm], [time_s])

    def _intervals(self, measured: HeartRateMeasurement, arrival_s: float) -> None:
        if self.has_better_intervals:
            return  # nothing is dropped: the sensor sends better ones
        intervals_s = measured.intervals_s
        if measured.is_saturated:
            # The length of this interval is unknown, so the beat clock restarts at its end.
            self._emit(self._beats.restart())
            intervals_s = measured.intervals_s_since_saturation
        placed = self._beats.place([Beat(each) for each in intervals_s], arrival_s)
        self._emit(placed)
        if placed and self._beats.is_placed_by_arrival:
            self._sink.note_arrival("ibi", arrival_s, len(placed))

    def _emit(self, placed: Sequence[PlacedBeat]) -> None:
        for beat, time_s in placed:
            self._sink.emit_at("ibi", [beat.interval_s], [time_s])

    def _in_contact(self, measured: HeartRateMeasurement, arrival_s: float) -> bool:
        if measured.intervals or self._interval_seen_s is None:
            self._interval_seen_s = arrival_s
        self._sends_intervals = self._sends_intervals or bool(measured.intervals)
        if measured.contact is not None:
            return measured.contact
        without_s = arrival_s - self._interval_seen_s if self._sends_intervals else 0.0
        return bool(measured.bpm) and without_s <= NO_INTERVAL_LIMIT_S
