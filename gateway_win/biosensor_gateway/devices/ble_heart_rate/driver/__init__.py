"""Driver for heart-rate straps of any make, and the services that all straps have."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

import structlog
from pydantic import Field

from biosensor_common.errors import (
    CredentialError,
    CredentialReason,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.ble_heart_rate.driver.protocol import (
    BATTERY_LEVEL,
    FIRMWARE_REVISION,
    HEART_RATE_MEASUREMENT,
    HEART_RATE_SERVICE,
    MANUFACTURER_NAME,
    MODEL_NUMBER,
    SERIAL_NUMBER,
    parse_battery_level,
    parse_text,
)
from biosensor_gateway.devices.ble_session import BleConnection, optional_request
from biosensor_gateway.devices.driver import Connected, DriverEntry, by_advertisement, own_settings
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_errors import PAIR_DESCRIPTION, AttError, Pairing, PairSetting
from biosensor_gateway.transports.nearby import Advertisement

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_log = structlog.get_logger("biosensor_gateway.ble_heart_rate")
_ADVICE = "put it on with wet electrodes, and disconnect it from phones and watches"
BATTERY_PERIOD_S = 300.0
DUE = {"hr": 7.5}
"""A strap measures once a second, an optical sensor every 5 s."""


class HeartRateStrapSettings(DeviceSettings):
    """Settings of one heart-rate strap."""

    device: str = Field(
        default="",
        max_length=64,
        description="Bluetooth address of the strap, as scan shows it, or its name, which another "
        "strap may also have; if empty, the only one in range that no other table uses.",
        examples=["C0:FF:EE:12:34:56"],
    )
    pair: PairSetting = Field(default="auto", description=PAIR_DESCRIPTION)


class HeartRateStrapDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    # A few straps stop sending while they are not worn.
    silence_limit_s = 15.0

    def __init__(self, link: BleLink, emitter: StrapEmitter, pairing: Pairing) -> None:
        self._link = link
        self._pairing = pairing
        self._emitter = emitter
        self._strap = Strap(link, emitter)
        self._connection = BleConnection(link)

    async def connect(self) -> Connected:
        """Connect and subscribe; see the protocol class."""
        await self._connection.connect()
        self._emitter.reconnected()
        if not self._link.has(HEART_RATE_MEASUREMENT):
            message = f"{self._link.what} measures no heart rate; choose another `device`"
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        info = await self._start()
        return Connected(info, denied=await self._strap.ask_for_battery(), due=DUE)

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Subscribe to the heart rate once more."""
        del streams
        await self._strap.subscribe_again()

    async def stream(self) -> None:
        """Emit what the strap sends, starting with what the link has buffered."""
        listen = partial(self._connection.listen, self._strap.take)
        await self._connection.run(self._emitter.signal_strength, self._strap.watch_battery, listen)

    async def close(self) -> None:
        """Try to unsubscribe within a short time, and disconnect."""
        await self._connection.close(self._strap.stop)

    async def _start(self) -> DeviceInfo:
        try:
            return await self._strap.start()
        except AttError as error:
            if not self._pairing.helps(error, is_unanswered=True):
                raise
            _log.info("pairing, because the strap does not answer unpaired", cause=str(error))
            self._pairing.note_demand()
        await self._link.pair()
        try:
            return await self._strap.start()
        except AttError as error:
            message = (
                f"{self._link.what} answers only when paired, and pairing does not help: remove it "
                "in the system's Bluetooth settings, then start again"
            )
            raise CredentialError(CredentialReason.REJECTED, message) from error


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], HeartRateStrapDriver]:
    """Share the emitter and the device selection between all connections."""
    own = own_settings(HeartRateStrapSettings, settings)
    emitter = StrapEmitter(sink)
    kind = identify_any if own.device else identify
    choice = Choice(kind, "heart-rate strap", own.device, _ADVICE, is_generic=True)
    pairing = Pairing(own.pair)

    def make() -> HeartRateStrapDriver:
        return HeartRateStrapDriver(BleLink(choice, sink.clock, pairing=pairing), emitter, pairing)

    return make


def identify(seen: Advertisement) -> str | None:
    """Return the address of a device that advertises the Heart Rate service, else None."""
    return seen.address if HEART_RATE_SERVICE in seen.service_uuids else None


def identify_any(seen: Advertisement) -> str | None:
    """Return the address of any device, because some straps do not advertise the service."""
    return seen.address


# A device that a specific driver recognises is left to that driver.
recognise = by_advertisement("ble_heart_rate", identify)


DRIVER = DriverEntry(HeartRateStrapSettings, _make, recognise=recognise)


class Strap:
    """Heart rate, battery and device information of one connection.

    Parameters
    ----------
    link
        The caller reads its notifications and passes them to :meth:`take`.
    """

    def __init__(self, link: BleLink, emitter: StrapEmitter) -> None:
        self._link = link
        self._emitter = emitter
        self._level: tuple[bytes, float] | None = None

    async def start(self) -> DeviceInfo:
        """Subscribe to the heart rate; return the device information.

        Services that the device lacks are skipped.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        AttError
            The device refuses to send its heart rate.
        """
        info = await self.identify()
        if self._link.has(HEART_RATE_MEASUREMENT):
            await self._link.subscribe(HEART_RATE_MEASUREMENT)
        return info

    async def identify(self) -> DeviceInfo:
        """Return the device information; raises TransportError like :meth:`start`."""
        return DeviceInfo(
            manufacturer=await self._text(MANUFACTURER_NAME),
            model=await self._text(MODEL_NUMBER),
            serial_number=await self._text(SERIAL_NUMBER),
            firmware_version=await self._text(FIRMWARE_REVISION),
        )

    async def ask_for_battery(self) -> dict[str, str]:
        """Read the battery level, to be emitted with the first data; return why it is denied.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        if "read" in self._link.properties(BATTERY_LEVEL):
            try:
                level = await self._link.read(BATTERY_LEVEL)
                if parse_battery_level(level) is None:
                    level = await self._link.read(BATTERY_LEVEL)
                if parse_battery_level(level) is None:
                    return {"bat": f"its level is no percentage: 0x{level.hex()}"}
                self._level = level, self._link.clock()
            except AttError as error:
                return {"bat": f"its level cannot be read: ATT error 0x{error.code:02X}"}
            except TransportError as error:
                # If the silence lasts, the watchdog of the streams reports it.
                if error.reason is not TransportReason.SILENT:
                    raise
        return {}

    def take(self, notification: Notification) -> None:
        """Emit the contents of a notification; other characteristics are ignored."""
        if notification.uuid == HEART_RATE_MEASUREMENT:
            self._emitter.measurement(notification.data, notification.arrival)
        elif notification.uuid == BATTERY_LEVEL:
            self._emitter.battery(notification.data, notification.arrival)

    async def watch_battery(self) -> None:
        """Emit the battery level now, and then at each notification or every 5 min.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        properties = self._link.properties(BATTERY_LEVEL)
        if self._level is not None:
            self._emitter.battery(*self._level)
        elif "read" in properties:
            await self._read_battery()
        # Subscribed after reading, because BlueZ also passes on values read as notifications.
        if "notify" in properties and await self._subscribe_to_battery():
            return
        while "read" in properties:
            await asyncio.sleep(BATTERY_PERIOD_S)
            await self._read_battery()

    async def subscribe_again(self) -> None:
        """Unsubscribe from the heart rate and subscribe again; raises like :meth:`start`."""
        if self._link.has(HEART_RATE_MEASUREMENT):
            await self._link.unsubscribe(HEART_RATE_MEASUREMENT)
            await self._link.subscribe(HEART_RATE_MEASUREMENT)

    async def stop(self) -> None:
        """Unsubscribe; raises like :meth:`start`."""
        if self._link.has(HEART_RATE_MEASUREMENT):
            await self._link.unsubscribe(HEART_RATE_MEASUREMENT)

    async def _text(self, uuid: str) -> str:
        if "read" in self._link.properties(uuid):
            with suppress(ProtocolError):
                return parse_text(await self._link.read(uuid))
        return ""

    async def _read_battery(self) -> None:
        with optional_request():
            data = await self._link.read(BATTERY_LEVEL)
            self._emitter.battery(data, self._link.clock())

    async def _subscribe_to_battery(self) -> bool:
        with optional_request():
            await self._link.subscribe(BATTERY_LEVEL)
            return True
        return False
