"""Turns values of characteristics into samples of the declared streams."""

from __future__ import annotations

from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.bluetooth_health.driver.services import ROWS, Row
from biosensor_gateway.devices.sink import Sink


class HealthEmitter:
    """Turns values into samples; one instance a device, over all its connections.

    These services stamp nothing, or by a clock that somebody set by hand: times are those of
    arrival.

    Attributes
    ----------
    strap
        Emits battery and signal strength.

    Parameters
    ----------
    sink
    wheel_m
        Circumference of the wheel.
    """

    def __init__(self, sink: Sink, wheel_m: float) -> None:
        self.strap = StrapEmitter(sink)
        self._sink = sink
        self._wheel_m = wheel_m
        self.reconnected()

    def reconnected(self) -> None:
        """Prepare for a new connection of the same device."""
        self._samples = {row.characteristic: row.sample(self._wheel_m) for row in ROWS}

    def take(self, row: Row, data: bytes, arrival_s: float) -> None:
        """Emit what a value holds; one that is cut short is counted and dropped."""
        found = row.parse(data)
        if found is None:
            self._sink.dropped_bytes += len(data)
            return
        self._sink.heard(row.stream)
        sample = self._samples[row.characteristic](found, arrival_s)
        contact = row.contact(found) if row.contact is not None else None
        if sample is not None and contact is not False:
            self._sink.emit_at(row.stream, [sample], [arrival_s])
        if contact is not None:
            self._sink.emit_at("quality", [[float(contact)]], [arrival_s])
