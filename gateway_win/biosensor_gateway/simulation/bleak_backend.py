"""A bleak backend with a virtual radio.

While `virtual_bluetooth` is active, code with plain ``BleakScanner`` and ``BleakClient`` connects
to virtual devices, which behave as on Windows, macOS or Linux: a local disconnect calls back like
a lost link, requests fail when the link is lost, and so on.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Generator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from typing import Any, TypeVar, TypeVarTuple, cast

from bleak.args import SizedBuffer
from bleak.assigned_numbers import gatt_char_props_to_strs
from bleak.backends.adapter import BaseBleakAdapter
from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.client import BaseBleakClient, NotifyCallback
from bleak.backends.descriptor import BleakGATTDescriptor
from bleak.backends.device import BLEDevice
from bleak.backends.scanner import AdvertisementData, AdvertisementDataCallback, BaseBleakScanner
from bleak.backends.service import BleakGATTService, BleakGATTServiceCollection
from bleak.exc import (
    BleakBluetoothNotAvailableError,
    BleakBluetoothNotAvailableReason,
    BleakDeviceNotFoundError,
    BleakError,
    BleakGATTProtocolError,
)
from bumble.att import ATT_DEFAULT_MTU, ATT_Error
from bumble.gatt_client import CharacteristicProxy, DescriptorProxy

from biosensor_common.errors import GatewayError, TransportError, TransportReason
from biosensor_gateway.simulation.bleak_pickers import standing_in
from biosensor_gateway.simulation.central import Central, GattLink, Heard, Listener, uncancelled
from biosensor_gateway.simulation.radio import Advertised, Radio, uuid_string
from biosensor_gateway.simulation.world import World

_T = TypeVar("_T")
_Ts = TypeVarTuple("_Ts")


async def in_world(world: World, coroutine: Coroutine[Any, Any, _T]) -> _T:
    """Run a coroutine in the world's event loop; cancelling this cancels it.

    Raises
    ------
    BleakError
        For any error, as in bleak's own backends.
    """
    try:
        return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(coroutine, world.loop))
    except ATT_Error as error:
        raise BleakGATTProtocolError(error.error_code) from error
    except (GatewayError, ValueError) as error:
        raise _as_bleak(error) from error


def tell(
    loop: asyncio.AbstractEventLoop, function: Callable[[*_Ts], object], *arguments: *_Ts
) -> None:
    """Call a function soon in another event loop, unless that is closed."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(function, *arguments)


def _as_bleak(error: Exception) -> BleakError:
    if isinstance(error, TransportError) and error.reason is TransportReason.UNAVAILABLE:
        reason = BleakBluetoothNotAvailableReason.POWERED_OFF
        return BleakBluetoothNotAvailableError(str(error), reason)
    return BleakError(str(error))


class VirtualClient(BaseBleakClient):
    """A connection through a virtual adapter.

    Parameters
    ----------
    address_or_ble_device, services, disconnected_callback, timeout
        As passed by ``BleakClient``.
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
        """Whether the link is established."""
        return self._connected

    async def connect(self, pair: bool, **kwargs: object) -> None:
        """Connect and discover the services.

        Raises
        ------
        BleakDeviceNotFoundError
            If only an address is known and it is not received in time.
        TimeoutError
            If a device found by a scan does not connect in time.
        BleakError
        """
        if self._connected:
            raise BleakError("Client is already connected")
        if not self._scanned:
            await self._find()
        with ExitStack() as failed:
            # The link may have been established at the moment of giving up.
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
        """End the connection, if there is one."""
        if link := self._link:
            await in_world(self._world, link.disconnect())

    async def pair(self, *_args: object, **_kwargs: object) -> None:
        """Pair with Just Works."""
        await self._ask(GattLink.pair)

    async def unpair(self) -> None:
        """Delete the bond, and disconnect."""
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
        # A request that was sent cannot be cancelled; the next one waits for it.
        return await uncancelled(in_world(self._world, request(link)))

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


@contextmanager
def virtual_bluetooth(radio: Radio) -> Generator[None]:
    """Let bleak use a virtual radio, in all event loops and threads of this process.

    Raises
    ------
    RuntimeError
        If this version of bleak selects its backends in an unknown way.
    """
    central = radio.world.await_(Central.on_the_air(radio))
    backends = partial(VirtualScanner, central), partial(VirtualClient, central), BaseBleakAdapter
    try:
        with standing_in(backends):
            yield
    finally:
        radio.world.await_(central.close())


class VirtualScanner(BaseBleakScanner):
    """A scan on a virtual adapter.

    As on every platform, data of a device are accumulated: the first callback may lack data of the
    scan response, usually the name.

    Parameters
    ----------
    detection_callback, service_uuids, scanning_mode
        As passed by ``BleakScanner``.
    """

    def __init__(
        self,
        central: Central,
        detection_callback: AdvertisementDataCallback | None,
        service_uuids: list[str] | None,
        scanning_mode: str = "active",
        **_of_platforms: object,
    ) -> None:
        super().__init__(detection_callback, service_uuids)
        self._central = central
        self._passive = scanning_mode == "passive"
        self._listener: Listener | None = None
        self._known: dict[str, Advertised] = {}

    async def start(self) -> None:
        """Start the scan."""
        if self._listener:
            raise BleakError("Scanner already started")
        self.seen_devices = {}
        self._known = {}
        loop = asyncio.get_running_loop()

        def listener(heard: Heard) -> None:
            tell(loop, self._on_heard, heard)

        await in_world(self._central.radio.world, self._central.listen(listener))
        self._listener = listener

    async def stop(self) -> None:
        """End the scan."""
        listener, self._listener = self._listener, None
        if listener:
            await in_world(self._central.radio.world, self._central.unlisten(listener))

    def _on_heard(self, heard: Heard) -> None:
        if self._passive and heard.is_response:
            return
        known = self._known.setdefault(heard.address, Advertised())
        known.hear(heard.data, heard.rssi_dbm)
        if not self.is_allowed_uuid(known.service_uuids):
            return
        data = AdvertisementData(
            local_name=known.name,
            manufacturer_data=dict(known.manufacturer_data),
            service_data={},
            service_uuids=list(known.service_uuids),
            tx_power=None,
            rssi=known.rssi_dbm,
            platform_data=(),
        )
        address = heard.address
        device = self.create_or_update_device(address, address, known.name, None, data)
        self.call_detection_callbacks(device, data)
