"""Driver for Polar devices that advertise their heart rate; it only receives."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack

from pydantic import Field

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.driver import Connected, DriverEntry, Found, own_settings
from biosensor_gateway.devices.polar_broadcast.driver.emitter import BroadcastEmitter
from biosensor_gateway.devices.polar_broadcast.driver.protocol import COMPANY, parse
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.system.clock import Clock
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_scanner import Sighting, sightings
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

READABLE_S = 5.0
"""Time for five measurements, of which at least one should be valid."""
ABSENT_S = 6.0
"""Without any advertisement for this time, the device is gone; less than the stream's limit."""
_DUE = {"hr": 7.5}
_OPTICAL = frozenset({"Sense", "Verity Sense", "OH1", "360", "Loop"})
_ADVICE = "put it on with wet electrodes, bring it nearer, or switch its broadcast on"


class PolarBroadcastSettings(DeviceSettings):
    """Settings of one Polar strap or watch that is listened to."""

    device: str = Field(
        default="",
        max_length=64,
        description="The id printed on the strap or told by the watch (8 characters), which is the "
        "last word of its name in scan, or its Bluetooth address; empty takes the only one in "
        "range that advertises a heart rate.",
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
                message = f"{self._choice.what} is not heard any more; {_ADVICE}"
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
        why = f"bytes came that cannot be read, {data.hex()}" if data else "it tells none"
        message = (
            f"{self._choice.what} is in range, but its advertisements hold no heart rate ({why}); "
            "switch its broadcast on, or use the sensor that connects to it"
        )
        return ProtocolError(ProtocolReason.UNSUPPORTED, message)


def _make(settings: DeviceSettings, sink: Sink) -> Callable[[], PolarBroadcastDriver]:
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
