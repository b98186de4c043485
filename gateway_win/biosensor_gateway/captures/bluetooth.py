"""A platform backend of bleak that plays a capture of a Bluetooth LE device.

Everything above it runs unchanged: the shared scan, the choice of the device, the link.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, cast

from bleak.args import SizedBuffer
from bleak.backends.adapter import BaseBleakAdapter
from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.client import BaseBleakClient, NotifyCallback
from bleak.backends.descriptor import BleakGATTDescriptor
from bleak.backends.device import BLEDevice
from bleak.backends.scanner import (
    AdvertisementData,
    AdvertisementDataCallback,
    BaseBleakScanner,
)
from bleak.backends.service import BleakGATTService, BleakGATTServiceCollection
from bleak.exc import BleakError, BleakGATTProtocolError

from biosensor_common.errors import TransportError
from biosensor_gateway.captures.file import Advertised, Event, Row
from biosensor_gateway.captures.link_player import LinkPlayer, Player
from biosensor_gateway.simulation.bleak_pickers import Backends
from biosensor_gateway.transports.tap import What
from biosensor_gateway.transports.threads import in_background

if TYPE_CHECKING:
    from bleak.assigned_numbers import CharacteristicPropertyName

_EVERY_S = 0.5
_MTU = 247
_NO_SUCH_ATTRIBUTE = 0x0A
_NEVER_S = 3600.0


def backends(player: Player, seen: Advertised) -> Backends:
    """Return scanner, client and adapter that play a capture."""
    return (
        partial(ReplayedScanner, player, seen),
        partial(ReplayedClient, player),
        BaseBleakAdapter,
    )


class ReplayedScanner(BaseBleakScanner):
    """Reports the advertisements of a capture's device while it is not connected.

    Parameters
    ----------
    detection_callback, service_uuids
        As ``BleakScanner`` passes them.
    """

    def __init__(
        self,
        player: Player,
        seen: Advertised,
        detection_callback: AdvertisementDataCallback | None,
        service_uuids: list[str] | None,
        scanning_mode: str = "active",
        **_of_platforms: object,
    ) -> None:
        del scanning_mode
        super().__init__(detection_callback, service_uuids)
        self._player, self._seen = player, seen
        self._advertising: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Begin to scan."""
        self.seen_devices = {}
        self._advertising = in_background(self._advertise())

    async def stop(self) -> None:
        """End the scan."""
        if self._advertising is not None:
            self._advertising.cancel()

    async def _advertise(self) -> None:
        seen = self._seen
        while True:
            if not self._player.rest_s:
                data = AdvertisementData(
                    local_name=seen.name or None,
                    manufacturer_data={
                        company: bytes.fromhex(each) for company, each in seen.manufacturer.items()
                    },
                    service_data={},
                    service_uuids=list(seen.services),
                    tx_power=None,
                    rssi=127 if seen.rssi_dbm is None else seen.rssi_dbm,
                    platform_data=(),
                )
                device = self.create_or_update_device(
                    seen.address, seen.address, seen.name or None, None, data
                )
                self.call_detection_callbacks(device, data)
            await asyncio.sleep(_EVERY_S)


class ReplayedClient(BaseBleakClient):
    """Plays the connections of a capture.

    Parameters
    ----------
    address_or_ble_device, services, disconnected_callback, timeout
        As ``BleakClient`` passes them.
    """

    def __init__(
        self,
        player: Player,
        address_or_ble_device: BLEDevice | str,
        *,
        services: set[str] | None = None,
        disconnected_callback: Callable[[], None] | None,
        timeout: float,
        **_of_platforms: object,
    ) -> None:
        del services
        super().__init__(
            address_or_ble_device, disconnected_callback=disconnected_callback, timeout=timeout
        )
        self._player = player
        self._link: LinkPlayer | None = None
        self._listeners: dict[str, NotifyCallback] = {}
        self._connected = False

    @property
    def name(self) -> str:
        """The device's address, because its name is not needed here."""
        return self.address

    @property
    def mtu_size(self) -> int:
        """The ATT MTU in use."""
        return _MTU

    @property
    def is_connected(self) -> bool:
        """Whether the link is connected."""
        return self._connected

    async def connect(self, pair: bool, **kwargs: object) -> None:
        """Make the next connection of the capture."""
        del pair, kwargs
        opening = self._player.next_opening
        try:
            self._link = await self._player.open(self._deliver)
        except TransportError as error:
            raise BleakError(str(error)) from error
        self.services = _services(opening.table)
        self._connected = True

    async def disconnect(self) -> None:
        """End the connection; without effect if there is none."""
        if self._link is not None:
            self._link.stop()
        self._end()

    async def pair(self, *_args: object, **_kwargs: object) -> None:
        """Pair with the captured outcome."""
        await self._ask(What.PAIRED)

    async def unpair(self) -> None:
        """Do nothing: a capture has no bond."""

    async def read_gatt_char(
        self,
        characteristic: BleakGATTCharacteristic,
        *,
        use_cached: bool = False,
        **kwargs: object,
    ) -> bytearray:
        """Read a characteristic; refuse one that was not read in the capture."""
        del use_cached, kwargs
        event = await self._ask(What.READ, characteristic.uuid)
        if event is None:
            raise BleakGATTProtocolError(_NO_SUCH_ATTRIBUTE)
        return bytearray(event.bytes)

    async def read_gatt_descriptor(
        self, descriptor: BleakGATTDescriptor, *, use_cached: bool = False, **kwargs: object
    ) -> bytearray:
        """Refuse: descriptors are not captured."""
        raise BleakGATTProtocolError(_NO_SUCH_ATTRIBUTE)

    async def write_gatt_char(
        self, characteristic: BleakGATTCharacteristic, data: SizedBuffer, response: bool
    ) -> None:
        """Write a characteristic."""
        del response
        await self._ask(What.WRITTEN, characteristic.uuid, bytes(data))

    async def write_gatt_descriptor(
        self, descriptor: BleakGATTDescriptor, data: SizedBuffer
    ) -> None:
        """Refuse: descriptors are not captured."""
        raise BleakGATTProtocolError(_NO_SUCH_ATTRIBUTE)

    async def start_notify(
        self,
        characteristic: BleakGATTCharacteristic,
        callback: NotifyCallback,
        **kwargs: object,
    ) -> None:
        """Subscribe."""
        del kwargs
        # Before the confirmation, because the device may send notifications before it.
        self._listeners[characteristic.uuid] = callback
        await self._ask(What.SUBSCRIBED, characteristic.uuid)

    async def stop_notify(self, characteristic: BleakGATTCharacteristic) -> None:
        """Unsubscribe."""
        await self._ask(What.UNSUBSCRIBED, characteristic.uuid)
        self._listeners.pop(characteristic.uuid, None)

    async def _ask(self, what: What, at: str = "", data: bytes = b"") -> Event | None:
        if self._link is None or not self._connected:
            raise BleakError("Not connected")
        event = await self._link.ask(what, at, data)
        if event is None or not event.error:
            return event
        kind, _, code = event.error.partition(":")
        if kind == "att" and code.isdigit():
            raise BleakGATTProtocolError(int(code))
        if kind == "silent":
            await asyncio.sleep(_NEVER_S)
        raise BleakError(event.error)

    def _deliver(self, event: Event) -> None:
        if event.what is What.LOST:
            self._end()
        elif listener := self._listeners.get(event.at):
            listener(bytearray(event.bytes))
        else:
            self._player.unheard += 1

    def _end(self) -> None:
        if self._connected:
            self._connected = False
            self.services = None
            if self._disconnected_callback:
                self._disconnected_callback()


def _services(table: tuple[Row, ...]) -> BleakGATTServiceCollection:
    collection = BleakGATTServiceCollection()
    services: dict[str, BleakGATTService] = {}
    for handle, row in enumerate(table, 1):
        service = services.get(row.service)
        if service is None:
            service = BleakGATTService(None, 1000 + handle, row.service)
            services[row.service] = service
            collection.add_service(service)
        properties = cast("list[CharacteristicPropertyName]", list(row.properties))
        characteristic = BleakGATTCharacteristic(
            None, handle, row.uuid, properties, lambda: _MTU - 3, service
        )
        collection.add_characteristic(characteristic)
    return collection
