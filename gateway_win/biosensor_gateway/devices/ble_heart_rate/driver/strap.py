"""The services common to all heart-rate straps, on a possibly shared connection."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from biosensor_common.errors import ProtocolError, TransportError, TransportReason
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.ble_heart_rate.driver.protocol import (
    BATTERY_LEVEL,
    FIRMWARE_REVISION,
    HEART_RATE_MEASUREMENT,
    MANUFACTURER_NAME,
    MODEL_NUMBER,
    SERIAL_NUMBER,
    parse_text,
)
from biosensor_gateway.devices.ble_session import optional_request
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.ble_errors import AttError

BATTERY_PERIOD_S = 300.0
DUE = {"hr": 7.5}
"""A strap measures once a second, an optical sensor every 5 s."""


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
                self._level = await self._link.read(BATTERY_LEVEL), self._link.clock()
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
