"""Driver for Polar devices that advertise their heart rate; it only receives."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Collection
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING

import structlog
from pydantic import Field

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.driver import Connected, DriverEntry, Found, own_settings
from biosensor_gateway.devices.polar_broadcast.driver.protocol import (
    COMPANY,
    COUNTS,
    Broadcast,
    parse,
)
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.system.clock import Clock
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_scanner import Sighting, sightings
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

READABLE_S = 5.0
"""Time for five measurements, of which at least one should be valid."""
ABSENT_S = 6.0
"""Without any advertisement for this time, the device is gone; less than the stream's limit."""
_DUE = {"hr": 7.5}
_OPTICAL = frozenset({"Sense", "Verity Sense", "OH1", "360", "Loop"})
_ADVICE = "put it on with wet electrodes, bring it nearer, or switch its broadcast on"
PERIOD_S = 1.0
COUNTABLE_S = 60.0
"""After a longer absence the device may have been switched off, so losses are not counted."""
_log = structlog.get_logger("biosensor_gateway.polar_broadcast")


class PolarBroadcastSettings(DeviceSettings):
    """Settings of one Polar strap or watch that is listened to."""

    device: str = Field(
        default="",
        max_length=64,
        description="The id printed on the strap or shown by the watch (8 characters), which is "
        "the last word of its name in scan, or its Bluetooth address; if empty, the only one "
        "in range that advertises a heart rate.",
        examples=["A1B2C3D4"],
    )


class PolarBroadcastDriver:
    """Receives until the device is gone; see the protocol class `Driver`."""

    # `stream` ends by itself when nothing is received.
    silence_limit_s = 15.0

    def __init__(self, choice: Choice, emitter: BroadcastEmitter, clock: Clock) -> None:
        self._choice = choice
        self._emitter = emitter
        self._clock = clock
        self._listening = AsyncExitStack()
        self._heard: AsyncIterator[Sighting] | None = None

    async def connect(self) -> Connected:
        """Find the device, and wait for a valid measurement."""
        found = (await self._choice.find()).advertisement
        self._choice.keep(found)
        self._heard = await self._listening.enter_async_context(sightings(found.address))
        try:
            async with asyncio.timeout(READABLE_S):
                while not _tells_rate(found):
                    found = (await anext(self._heard)).advertisement
        except TimeoutError as error:
            raise self._unreadable(found) from error
        model, serial_number = _named(found)
        return Connected(
            DeviceInfo(manufacturer="Polar", model=model, serial_number=serial_number), due=_DUE
        )

    async def stream(self) -> None:
        """Emit the received measurements."""
        loop = asyncio.get_running_loop()
        while self._heard is not None:
            try:
                async with asyncio.timeout(ABSENT_S):
                    sighting = await anext(self._heard)
            except TimeoutError as error:
                message = f"{self._choice.what} can no longer be heard; {_ADVICE}"
                raise TransportError(TransportReason.ABSENT, message) from error
            seen = sighting.advertisement
            # Without the time that it waited in the queue.
            arrival_s = self._clock() - (loop.time() - sighting.heard_s)
            self._emitter.feels_skin = _named(seen)[0] not in _OPTICAL
            self._emitter.heard(seen.manufacturer_data.get(COMPANY, b""), arrival_s, seen.rssi_dbm)

    async def close(self) -> None:
        """Stop receiving."""
        self._heard = None
        await self._listening.aclose()

    def _unreadable(self, found: Advertisement) -> ProtocolError:
        data = found.manufacturer_data.get(COMPANY, b"")
        why = f"unreadable bytes came, {data.hex()}" if data else "it tells none"
        message = (
            f"{self._choice.what} is in range, but its advertisements contain no heart rate "
            f"({why}); switch its broadcast on, or use the sensor that connects to it"
        )
        return ProtocolError(ProtocolReason.UNSUPPORTED, message)


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], PolarBroadcastDriver]:
    """Share the emitter and the device selection between all connections."""
    own = own_settings(PolarBroadcastSettings, settings)
    emitter = BroadcastEmitter(sink)
    kind = identify_any if own.device else identify
    choice = Choice(kind, "Polar broadcast", own.device, _ADVICE, is_generic=True, connects=False)
    return lambda: PolarBroadcastDriver(choice, emitter, sink.clock)


def _named(seen: Advertisement) -> tuple[str, str]:
    """Return model and id from the name ``Polar <model> <id>``; empty if unknown."""
    words = seen.name.split()
    if len(words) < 3 or words[0] != "Polar":
        return "", ""
    return " ".join(words[1:-1]), words[-1]


def _tells_rate(seen: Advertisement) -> bool:
    return parse(seen.manufacturer_data.get(COMPANY, b"")) is not None


def identify(seen: Advertisement) -> str | None:
    """Return the id, or without a name the address, of a device that advertises a heart rate."""
    return identify_any(seen) if _tells_rate(seen) else None


def identify_any(seen: Advertisement) -> str | None:
    """Return the id, or without a name the address, of any Polar device; None for others."""
    is_polar = COMPANY in seen.manufacturer_data or seen.name.startswith("Polar ")
    return (_named(seen)[1] or seen.address) if is_polar else None


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Recognise a device that advertises its heart rate."""
    identity = identify(seen) if isinstance(seen, Advertisement) else None
    if not isinstance(seen, Advertisement) or identity is None:
        return None
    settings = {"unit": identity, "device": identity}
    return Found("polar_broadcast", seen.name.strip() or identity, settings, seen.rssi_dbm)


DRIVER = DriverEntry(PolarBroadcastSettings, _make, recognise=recognise)


class BroadcastEmitter:
    """Processes a device's advertisements; one instance per device, over all its connections.

    Each measurement is advertised repeatedly until the next one. It is emitted when first
    received, with that arrival time.
    """

    def __init__(self, sink: DeviceSink) -> None:
        self._sink = sink
        # Whether the device can detect that it is worn; the contact bit of optical sensors is
        # meaningless.
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
                f"was not received for {away_s:.0f} s; what it may have measured in that time is "
                "not counted as lost"
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
        self._sink.lacking["quality"] = [] if self.feels_skin else ["contact"]
        contact = float(broadcast.contact) if self.feels_skin else math.nan
        # nothing is dropped: 0 is no heart rate
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
            _log.warning("reports that its battery should be changed or charged")
