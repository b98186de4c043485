"""Converts advertised heart rates to samples, and counts those not received."""

from __future__ import annotations

import math
from collections.abc import Collection

import structlog

from biosensor_gateway.devices.polar_broadcast.driver.protocol import COUNTS, Broadcast, parse
from biosensor_gateway.devices.sink import Sink

PERIOD_S = 1.0
COUNTABLE_S = 60.0
"""After a longer absence the device may have been switched off, so losses are not counted."""
_log = structlog.get_logger("biosensor_gateway.polar_broadcast")


class BroadcastEmitter:
    """Processes a device's advertisements; one instance per device, over all its connections.

    Each measurement is advertised repeatedly until the next one. It is emitted when first
    received, with that arrival time.

    Attributes
    ----------
    feels_skin
        Whether the device can detect that it is worn; the contact bit of optical sensors is
        meaningless.
    """

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self.feels_skin = True
        self._data = b""
        self._last: Broadcast | None = None
        self._heard_s = 0.0
        self._counts = False
        self._told: Collection[str] = frozenset()

    def heard(self, data: bytes, arrival_s: float, rssi_dbm: int | None) -> None:
        """Process manufacturer data received at an LSL time."""
        broadcast = parse(data)
        is_repeated, self._data = data == self._data, data
        if broadcast is None:
            self._sink.dropped_bytes += 0 if is_repeated else len(data)
            return
        steps = self._steps(broadcast, arrival_s)
        if steps:
            self._emit(broadcast, arrival_s, rssi_dbm, lost=steps - 1)
        elif not self._counts:
            # An unchanged value does not show whether the device still measures.
            self._sink.heard("hr")
        self._last, self._heard_s = broadcast, arrival_s

    def _steps(self, broadcast: Broadcast, arrival_s: float) -> int:
        """Return the number of new measurements; a guess after the counter has wrapped around."""
        if self._last is None:
            return 1
        away_s = arrival_s - self._heard_s
        steps = (broadcast.counter - self._last.counter) % COUNTS
        self._counts = self._counts or steps > 0
        if not self._counts:
            return int(broadcast.bpm != self._last.bpm)
        if away_s > COUNTABLE_S:
            _log.warning(
                f"was not heard for {away_s:.0f} s; what it may have measured meanwhile is not "
                "counted as lost"
            )
            return 1
        return steps + COUNTS * max(0, round((away_s / PERIOD_S - steps) / COUNTS))

    def _emit(
        self, broadcast: Broadcast, arrival_s: float, rssi_dbm: int | None, *, lost: int
    ) -> None:
        self._sink.heard("hr")
        is_worn = broadcast.contact or not self.feels_skin
        if not is_worn:
            # The advertised rate is an old one.
            self._sink.excuse("hr")
        rates = {"hr": broadcast.bpm, "hr_fast": broadcast.fast_bpm} if is_worn else {}
        contact = float(broadcast.contact) if self.feels_skin else math.nan
        samples = {name: [float(bpm)] for name, bpm in rates.items() if bpm}
        samples["quality"] = [contact, float(broadcast.battery_ok)]
        for data_name, sample in samples.items():
            # Before the first value, and without skin contact, there are no values to lose.
            if lost and data_name in self._told:
                self._sink.lost(data_name, lost)
            self._sink.emit_at(data_name, [sample], [arrival_s])
        self._told = samples.keys()
        if rssi_dbm is not None:
            self._sink.emit_at("rssi", [rssi_dbm], [arrival_s])
        if not broadcast.battery_ok and (self._last is None or self._last.battery_ok):
            # nothing is dropped: it is about the battery
            _log.warning("says that its battery is to be changed or charged")
