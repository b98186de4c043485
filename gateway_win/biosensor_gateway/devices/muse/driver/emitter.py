"""Turns what any headband sends into samples of the declared streams."""

from __future__ import annotations

from typing import NamedTuple

from biosensor_gateway.devices.muse.driver.athena_emitter import AthenaEmitter
from biosensor_gateway.devices.muse.driver.classic_emitter import ClassicEmitter
from biosensor_gateway.devices.muse.driver.gatt import FRAMES
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.system.device_log import DeviceLog
from biosensor_gateway.transports.ble import Notification


class Started(NamedTuple):
    """What a headband was told to send.

    Attributes
    ----------
    wanted
        Data names of the regular streams.
    percent
        What it says is left in the battery; None if it does not.
    """

    wanted: frozenset[str]
    percent: float | None


class MuseEmitter:
    """Turns packets into samples; one instance a device, over all its connections."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._log = DeviceLog("biosensor_gateway.muse", sink.identity)
        self._classic = ClassicEmitter(sink, self._log)
        self._athena = AthenaEmitter(sink, self._log)

    def started(self, started: Started) -> None:
        """Expect packets that are counted again; to be called before they can come."""
        self._classic.started(has_aux="aux" in started.wanted)
        self._athena.started(*started)

    def take(self, notification: Notification) -> None:
        """Emit what a notification holds; what makes no sense is counted and dropped."""
        data, arrival_s = notification.data, notification.arrival
        if notification.uuid in FRAMES:
            dropped = self._athena.take(data, arrival_s)
        else:
            is_readable = self._classic.take(notification.uuid, data, arrival_s)
            dropped = 0 if is_readable else len(data)
        if dropped:
            self._sink.dropped_bytes += dropped
            self._log.warn_once("packets are dropped", start=data[:10].hex())

    def signal_strength(self, rssi_dbm: int | None, seen_s: float) -> None:
        """Emit how strongly an advertisement was heard; None is passed over."""
        if rssi_dbm is not None:
            self._sink.emit_at("rssi", [rssi_dbm], [seen_s])
