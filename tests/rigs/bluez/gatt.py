"""The GATT objects of a device that is connected."""

from __future__ import annotations

from collections.abc import Awaitable
from contextlib import suppress
from functools import partial
from typing import TypeVar

from bleak.assigned_numbers import gatt_char_props_to_strs
from bumble.att import ATT_Error
from bumble.gatt_client import CharacteristicProxy, DescriptorProxy, ServiceProxy
from dbus_fast.message import Message
from dbus_fast.signature import Variant

from biosensor_common.errors import TransportError
from biosensor_gateway.simulation.advertising import uuid_string
from biosensor_gateway.simulation.central import GattLink
from tests.rigs.bluez.errors import (
    BluezError,
    att_error,
    failed,
    in_progress,
    not_supported,
    request_lost,
)
from tests.rigs.bluez.objects import ObjectTree, Reply

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
