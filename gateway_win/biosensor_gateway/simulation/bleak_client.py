"""The ``BleakClient`` backend of virtual Bluetooth."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import ExitStack
from typing import Any, TypeVar, cast

from bleak.args import SizedBuffer
from bleak.assigned_numbers import gatt_char_props_to_strs
from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.client import BaseBleakClient, NotifyCallback
from bleak.backends.descriptor import BleakGATTDescriptor
from bleak.backends.device import BLEDevice
from bleak.backends.service import BleakGATTService, BleakGATTServiceCollection
from bleak.exc import BleakDeviceNotFoundError, BleakError
from bumble.att import ATT_DEFAULT_MTU
from bumble.gatt_client import CharacteristicProxy, DescriptorProxy

from biosensor_gateway.simulation.advertising import uuid_string
from biosensor_gateway.simulation.central import Central
from biosensor_gateway.simulation.crossing import in_world, tell
from biosensor_gateway.simulation.gatt_link import GattLink

_T = TypeVar("_T")


class VirtualClient(BaseBleakClient):
    """A connection through a virtual adapter.

    Parameters
    ----------
    central
        The adapter.
    address_or_ble_device, services, disconnected_callback, timeout
        As ``BleakClient`` hands them on.
    """

    def __init__(
        self,
        central: Central,
        address_or_ble_device: BLEDevice | str,
        *,
        services: set[str] | None = None,
        disconnected_callback: Callable[[], None] | None,
        timeout: float,
        **_of_platforms: object,
    ) -> None:
        super().__init__(
            address_or_ble_device, disconnected_callback=disconnected_callback, timeout=timeout
        )
        known = address_or_ble_device if isinstance(address_or_ble_device, BLEDevice) else None
        self._central = central
        self._world = central.radio.world
        self._scanned = known is not None
        self._name = (known and known.name) or self.address.replace(":", "-")
        self._wanted = services
        self._link: GattLink | None = None
        self._closing: asyncio.Future[None] | None = None
        self._connected = False

    @property
    def name(self) -> str:
        """The advertised name, or the address."""
        return self._name

    @property
    def mtu_size(self) -> int:
        """The ATT MTU in use."""
        return self._link.mtu if self._link else ATT_DEFAULT_MTU

    @property
    def is_connected(self) -> bool:
        """Whether the link stands."""
        return self._connected

    async def connect(self, pair: bool, **kwargs: object) -> None:
        """Connect and discover the services.

        Raises
        ------
        BleakDeviceNotFoundError
            If only an address is known, and it is not heard in time.
        TimeoutError
            If a device that a scan found does not connect in time.
        BleakError
        """
        if self._connected:
            raise BleakError("Client is already connected")
        if not self._scanned:
            await self._find()
        with ExitStack() as failed:
            # The link may have come about in the moment of giving up.
            failed.callback(tell, self._world.loop, self._close_unwanted)
            async with asyncio.timeout(self._timeout):
                loop = asyncio.get_running_loop()
                link = await in_world(self._world, self._open(loop, pair))
            failed.pop_all()
        if link.lost:
            raise BleakError(f"{self.address} was lost while connecting")
        self.services = _services(link, self._wanted)
        self._connected = True

    async def disconnect(self) -> None:
        """End the connection; without effect if there is none."""
        if link := self._link:
            await in_world(self._world, link.disconnect())

    async def pair(self, *_args: object, **_kwargs: object) -> None:
        """Pair, Just Works."""
        await self._ask(GattLink.pair)

    async def unpair(self) -> None:
        """Forget the bond, and disconnect."""
        await self._ask(GattLink.unpair)

    async def read_gatt_char(
        self,
        characteristic: BleakGATTCharacteristic,
        *,
        use_cached: bool = False,
        **kwargs: object,
    ) -> bytearray:
        """Read a characteristic from the device."""
        proxy = _proxy(characteristic)
        return bytearray(await self._ask(lambda link: link.read(proxy)))

    async def read_gatt_descriptor(
        self, descriptor: BleakGATTDescriptor, *, use_cached: bool = False, **kwargs: object
    ) -> bytearray:
        """Read a descriptor from the device."""
        proxy = cast("DescriptorProxy", descriptor.obj)
        return bytearray(await self._ask(lambda link: link.read(proxy)))

    async def write_gatt_char(
        self, characteristic: BleakGATTCharacteristic, data: SizedBuffer, response: bool
    ) -> None:
        """Write a characteristic."""
        proxy, content = _proxy(characteristic), bytes(data)
        await self._ask(lambda link: link.write(proxy, content, response=response))

    async def write_gatt_descriptor(
        self, descriptor: BleakGATTDescriptor, data: SizedBuffer
    ) -> None:
        """Write a descriptor."""
        proxy, content = cast("DescriptorProxy", descriptor.obj), bytes(data)
        await self._ask(lambda link: link.write(proxy, content, response=True))

    async def start_notify(
        self,
        characteristic: BleakGATTCharacteristic,
        callback: NotifyCallback,
        **kwargs: object,
    ) -> None:
        """Subscribe; notifications are preferred over indications."""
        loop, proxy = asyncio.get_running_loop(), _proxy(characteristic)

        def on_value(value: bytes) -> None:
            tell(loop, callback, bytearray(value))

        await self._ask(lambda link: link.subscribe(proxy, on_value))

    async def stop_notify(self, characteristic: BleakGATTCharacteristic) -> None:
        """Unsubscribe."""
        proxy = _proxy(characteristic)
        await self._ask(lambda link: link.unsubscribe(proxy))

    async def _ask(self, request: Callable[[GattLink], Coroutine[Any, Any, _T]]) -> _T:
        link = self._link
        if link is None or not self._connected:
            raise BleakError("Not connected")
        # A request that is on the air cannot be taken back; the next one waits for it.
        return await asyncio.shield(in_world(self._world, request(link)))

    async def _find(self) -> None:
        try:
            async with asyncio.timeout(self._timeout):
                await in_world(self._world, self._central.wait_for(self.address))
        except TimeoutError as error:
            message = f"Device with address {self.address} was not found."
            raise BleakDeviceNotFoundError(self.address, message) from error

    async def _open(self, loop: asyncio.AbstractEventLoop, pair: bool) -> GattLink:
        link = await self._central.connect(self.address)
        link.on_lost.append(lambda: tell(loop, self._on_lost, link))
        self._link = link
        if pair:
            await link.pair()
        return link

    def _close_unwanted(self) -> None:
        if link := self._link:
            self._link = None
            self._closing = asyncio.ensure_future(link.disconnect())

    def _on_lost(self, link: GattLink) -> None:
        if self._link is link:
            self._link = None
        if self._connected:
            self._connected = False
            self.services = None
            if self._disconnected_callback:
                self._disconnected_callback()


def _proxy(characteristic: BleakGATTCharacteristic) -> CharacteristicProxy[bytes]:
    return cast("CharacteristicProxy[bytes]", characteristic.obj)


def _services(link: GattLink, wanted: set[str] | None) -> BleakGATTServiceCollection:
    collection = BleakGATTServiceCollection()
    for found in link.services:
        service = BleakGATTService(found, found.handle, uuid_string(found.uuid))
        if wanted is not None and service.uuid not in wanted:
            continue
        collection.add_service(service)
        for proxy in found.characteristics:
            characteristic = BleakGATTCharacteristic(
                proxy,
                proxy.handle,
                uuid_string(proxy.uuid),
                list(gatt_char_props_to_strs(proxy.properties)),
                lambda: link.max_command_bytes,
                service,
            )
            collection.add_characteristic(characteristic)
            for descriptor in proxy.descriptors:
                uuid = uuid_string(descriptor.type)
                collection.add_descriptor(
                    BleakGATTDescriptor(descriptor, descriptor.handle, uuid, characteristic)
                )
    return collection
