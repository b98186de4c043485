"""A device that BlueZ knows, org.bluez.Device1, and its GATT objects."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from contextlib import suppress
from functools import partial
from math import inf
from typing import TYPE_CHECKING, TypeVar

from bleak.assigned_numbers import gatt_char_props_to_strs
from bumble.att import ATT_Error
from bumble.gatt_client import CharacteristicProxy, DescriptorProxy, ServiceProxy
from dbus_fast.message import Message
from dbus_fast.signature import Variant

from biosensor_common.errors import GatewayError, TransportError
from biosensor_gateway.simulation.central import GattLink, Heard
from biosensor_gateway.simulation.radio import Advertised, uuid_string
from tests.rigs.bluez.objects import (
    BluezError,
    Method,
    ObjectTree,
    Properties,
    Reply,
    att_error,
    failed,
    in_progress,
    not_connected,
    not_ready,
    not_supported,
    request_lost,
)

if TYPE_CHECKING:
    from tests.rigs.bluez.adapter import FakeBluez

# A device that BlueZ knows: org.bluez.Device1.

DEVICE = "org.bluez.Device1"
_STEADY_S = 1.0
"""No real radio is heard at the same strength for longer. A program that misses what is
told at the begin of its scan, as bleak may, is told so again."""


class FakeDevice:
    """One device, from its first advertisement until BlueZ forgets it.

    Parameters
    ----------
    bluez
        Who knows it.
    adapter_path
        Above it.
    address
    """

    def __init__(self, bluez: FakeBluez, adapter_path: str, address: str) -> None:
        self.path = f"{adapter_path}/dev_{address.replace(':', '_')}"
        self._bluez = bluez
        self._tree = bluez.tree
        self._adapter_path = adapter_path
        self._address = address
        self._advertised = Advertised()
        self._link: GattLink | None = None
        self._objects: GattObjects | None = None
        self._connecting: asyncio.Task[None] | None = None
        self._strength_told_s = -inf

    @property
    def connected(self) -> bool:
        """Whether it is, or is being connected."""
        return self._link is not None or self._connecting is not None

    def hear(self, heard: Heard, *, duplicates: bool) -> None:
        """Take an advertisement in, and tell what changed, or everything."""
        self._advertised.hear(heard.data, heard.rssi_dbm)
        told = self._from_advertisement()
        if self.path not in self._tree:
            self._tree.add(self.path, DEVICE, {**self._unheard(), **told}, self._methods())
            return
        changed = {
            name: variant
            for name, variant in told.items()
            if duplicates or self._tree.property(self.path, DEVICE, name) != variant.value
        }
        now_s = asyncio.get_running_loop().time()
        if now_s - self._strength_told_s >= _STEADY_S:
            changed["RSSI"] = told["RSSI"]
        if "RSSI" in changed:
            self._strength_told_s = now_s
        if changed:
            self._tree.change(self.path, DEVICE, changed)

    def unheard(self) -> None:
        """Forget the signal strength, as BlueZ does when a scan ends."""
        self._tree.change(self.path, DEVICE, {}, ["RSSI"])

    def forget(self) -> None:
        """Withdraw the object."""
        self._tree.remove(self.path)

    async def unpair(self) -> None:
        """Forget the bond, and disconnect."""
        if self._link:
            await self._link.unpair()

    async def end_client(self, name: str) -> None:
        """Keep the connection of a program that has left the bus, and end what it was told."""
        if self._objects:
            await self._objects.end_client(name)

    def _methods(self) -> dict[str, Method]:
        return {"Connect": self._connect, "Disconnect": self._disconnect, "Pair": self._pair}

    def _unheard(self) -> Properties:
        return {
            "Address": Variant("s", self._address),
            "AddressType": Variant("s", "random"),
            "Alias": Variant("s", self._address.replace(":", "-")),
            "Adapter": Variant("o", self._adapter_path),
            "Paired": Variant("b", False),
            "Bonded": Variant("b", False),
            "Trusted": Variant("b", False),
            "Blocked": Variant("b", False),
            "LegacyPairing": Variant("b", False),
            "Connected": Variant("b", False),
            "ServicesResolved": Variant("b", False),
        }

    def _from_advertisement(self) -> Properties:
        known = self._advertised
        told = {
            "RSSI": Variant("n", known.rssi_dbm),
            "UUIDs": Variant("as", list(known.service_uuids)),
        }
        if known.manufacturer_data:
            data = {key: Variant("ay", value) for key, value in known.manufacturer_data.items()}
            told["ManufacturerData"] = Variant("a{qv}", data)
        if known.name is not None:
            told["Name"] = told["Alias"] = Variant("s", known.name)
        return told

    async def _connect(self, _call: Message) -> Reply:
        if not self._bluez.powered:
            raise not_ready()
        if self._link:
            return None
        if self._connecting:
            raise in_progress()
        self._connecting = asyncio.ensure_future(self._attempt())
        try:
            await self._connecting
        except asyncio.CancelledError:
            raise failed("le-connection-abort-by-local") from None
        except GatewayError as error:
            raise failed("Software caused connection abort") from error
        finally:
            self._connecting = None
        return None

    async def _attempt(self) -> None:
        await asyncio.sleep(self._bluez.connect_delay_s)
        if self._bluez.connect_error:
            raise failed(self._bluez.connect_error)
        self._show(await self._bluez.central.connect(self._address))

    def _show(self, link: GattLink) -> None:
        self._link = link
        link.on_lost.append(self._on_lost)
        self._tree.change(self.path, DEVICE, {"Connected": Variant("b", True)})
        self._objects = GattObjects(
            self._tree, self.path, link, words_security=self._bluez.words_security
        )
        resolved = {
            "UUIDs": Variant("as", self._objects.uuids),
            "ServicesResolved": Variant("b", True),
        }
        self._tree.change(self.path, DEVICE, resolved)

    async def _disconnect(self, _call: Message) -> Reply:
        if self._connecting:
            self._connecting.cancel()
        elif self._link:
            await self._link.disconnect()
        else:
            raise not_connected()
        return None

    async def _pair(self, call: Message) -> Reply:
        await self._connect(call)
        assert self._link
        try:
            await self._link.pair()
        except GatewayError as error:
            text = "Authentication Failed"
            raise BluezError("org.bluez.Error.AuthenticationFailed", text) from error
        paired = {"Paired": Variant("b", True), "Bonded": Variant("b", True)}
        self._tree.change(self.path, DEVICE, paired)
        return None

    def _on_lost(self) -> None:
        self._link = None
        self._tree.change(self.path, DEVICE, {"ServicesResolved": Variant("b", False)})
        self._tree.change(self.path, DEVICE, {"Connected": Variant("b", False)})
        if self._objects:
            self._objects.remove()
            self._objects = None


# The GATT objects of a device that is connected.
_T = TypeVar("_T")
_SERVICE = "org.bluez.GattService1"
_CHARACTERISTIC = "org.bluez.GattCharacteristic1"
_DESCRIPTOR = "org.bluez.GattDescriptor1"
# BlueZ keeps the Generic Access service to itself.
_HIDDEN = frozenset({"00001800-0000-1000-8000-00805f9b34fb"})
_NOTIFYING_PROPERTIES = {"notify", "indicate"}


class GattObjects:
    """Services, characteristics and descriptors of one link.

    Parameters
    ----------
    tree
        Where they are shown.
    device_path
        Above them.
    link
    words_security
        Whether a request that needs pairing is answered with those words.
    """

    def __init__(
        self, tree: ObjectTree, device_path: str, link: GattLink, *, words_security: bool
    ) -> None:
        self._words_security = words_security
        self._tree = tree
        self._link = link
        self._notified: dict[str, set[str | None]] = {}
        self._proxies: dict[str, CharacteristicProxy[bytes]] = {}
        self._paths: list[str] = []
        self.uuids = [uuid_string(service.uuid) for service in link.services]
        for service in link.services:
            if uuid_string(service.uuid) not in _HIDDEN:
                self._add_service(device_path, service)

    def remove(self) -> None:
        """Withdraw them all."""
        for path in self._paths:
            self._tree.remove(path)

    async def end_client(self, name: str) -> None:
        """End the notifications of a program that has left the bus."""
        for path, notified in self._notified.items():
            if name in notified:
                with suppress(BluezError):
                    await self._unnotify(path, name)

    def _add_service(self, device_path: str, service: ServiceProxy) -> None:
        path = f"{device_path}/service{service.handle:04x}"
        properties = {
            "UUID": Variant("s", uuid_string(service.uuid)),
            "Device": Variant("o", device_path),
            "Primary": Variant("b", True),
            "Includes": Variant("ao", []),
        }
        self._tree.add(path, _SERVICE, properties, {})
        self._paths.append(path)
        for characteristic in service.characteristics:
            self._add_characteristic(path, characteristic)

    def _add_characteristic(
        self, service_path: str, characteristic: CharacteristicProxy[bytes]
    ) -> None:
        # BlueZ counts by the declaration, which is just before the value.
        path = f"{service_path}/char{characteristic.handle - 1:04x}"
        flags = sorted(gatt_char_props_to_strs(characteristic.properties))
        properties = {
            "UUID": Variant("s", uuid_string(characteristic.uuid)),
            "Service": Variant("o", service_path),
            "Value": Variant("ay", b""),
            "Flags": Variant("as", flags),
            "MTU": Variant("q", self._link.mtu),
        }
        methods = {
            "ReadValue": partial(self._read, path, characteristic),
            "WriteValue": partial(self._write, characteristic),
        }
        if _NOTIFYING_PROPERTIES & set(flags):
            properties["Notifying"] = Variant("b", False)
        methods["StartNotify"] = partial(self._start_notify, path, characteristic)
        methods["StopNotify"] = partial(self._stop_notify, path)
        self._tree.add(path, _CHARACTERISTIC, properties, methods)
        for descriptor in characteristic.descriptors:
            self._add_descriptor(path, descriptor)

    def _add_descriptor(self, characteristic_path: str, descriptor: DescriptorProxy) -> None:
        properties = {
            "UUID": Variant("s", uuid_string(descriptor.type)),
            "Characteristic": Variant("o", characteristic_path),
            "Value": Variant("ay", b""),
        }
        path = f"{characteristic_path}/desc{descriptor.handle:04x}"
        methods = {"ReadValue": partial(self._read_descriptor, descriptor)}
        self._tree.add(path, _DESCRIPTOR, properties, methods)

    async def _read(
        self, path: str, characteristic: CharacteristicProxy[bytes], _call: Message
    ) -> Reply:
        value = await self._answered(self._link.read(characteristic))
        # Whoever is notified hears of what was read, too.
        self._show(path, value)
        return "ay", [value]

    async def _read_descriptor(self, descriptor: DescriptorProxy, _call: Message) -> Reply:
        return "ay", [await self._answered(self._link.read(descriptor))]

    async def _write(self, characteristic: CharacteristicProxy[bytes], call: Message) -> Reply:
        value, options = call.body
        response = options["type"].value == "request"
        await self._answered(self._link.write(characteristic, bytes(value), response=response))
        return None

    async def _start_notify(
        self, path: str, characteristic: CharacteristicProxy[bytes], call: Message
    ) -> Reply:
        if self._tree.property(path, _CHARACTERISTIC, "Notifying") is None:
            raise not_supported()
        notified = self._notified.setdefault(path, set())
        if call.sender in notified:
            raise in_progress()
        if not notified:
            self._proxies[path] = characteristic
            await self._answered(self._link.subscribe(characteristic, partial(self._show, path)))
        notified.add(call.sender)
        self._tree.change(path, _CHARACTERISTIC, {"Notifying": Variant("b", True)})
        return None

    async def _stop_notify(self, path: str, call: Message) -> Reply:
        if call.sender not in self._notified.get(path, set()):
            raise failed("No notify session started")
        await self._unnotify(path, call.sender)
        return None

    async def _unnotify(self, path: str, name: str | None) -> None:
        notified = self._notified[path]
        notified.remove(name)
        if not notified:
            await self._answered(self._link.unsubscribe(self._proxies[path]))
            self._tree.change(path, _CHARACTERISTIC, {"Notifying": Variant("b", False)})

    def _show(self, path: str, value: bytes) -> None:
        self._tree.change(path, _CHARACTERISTIC, {"Value": Variant("ay", value)})

    async def _answered(self, request: Awaitable[_T]) -> _T:
        try:
            return await request
        except ATT_Error as error:
            raise att_error(error, words_security=self._words_security) from error
        except TransportError as error:
            raise request_lost() from error
        except ValueError as error:
            raise failed("Failed to initiate write") from error
