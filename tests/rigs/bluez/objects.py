"""Objects on a D-Bus: their properties, methods and signals."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Protocol, cast

from dbus_fast.aio import MessageBus
from dbus_fast.constants import MessageType
from dbus_fast.message import Message
from dbus_fast.signature import Variant

from tests.rigs.bluez.errors import BluezError, failed, unknown_object

OBJECT_MANAGER = "org.freedesktop.DBus.ObjectManager"
PROPERTIES = "org.freedesktop.DBus.Properties"

Properties = dict[str, Variant]
Reply = tuple[str, list[Any]] | None
Method = Callable[[Message], Awaitable[Reply]]
"""Takes a call; returns the signature and the values of its answer, or raises BluezError."""


class _Bus(Protocol):
    """What is used of the bus, whose annotation leaves a type argument out."""

    def send(self, msg: Message) -> object: ...


class ObjectTree:
    """The objects that one service shows; for the loop of its bus.

    Parameters
    ----------
    bus
        Connected.
    late
        By member, for how many seconds the answer to the next call of it is kept back; what
        is called for is done at once. Each is taken out.
    """

    def __init__(self, bus: MessageBus, late: dict[str, float] | None = None) -> None:
        self._late = {} if late is None else late
        self._bus = bus
        self._send = cast("_Bus", bus).send
        self._objects: dict[str, dict[str, Properties]] = {}
        self._methods: dict[tuple[str, str, str], Method] = {}
        self._calls: set[asyncio.Task[None]] = set()
        bus.add_message_handler(self._on_message)

    def __contains__(self, path: str) -> bool:
        return path in self._objects

    def add(
        self, path: str, interface: str, properties: Properties, methods: Mapping[str, Method]
    ) -> None:
        """Show an object with one interface."""
        self._objects[path] = {interface: properties}
        for name, method in methods.items():
            self._methods[path, interface, name] = method
        body = [path, {interface: properties}]
        self._signal("/", OBJECT_MANAGER, "InterfacesAdded", "oa{sa{sv}}", body)

    def remove(self, path: str) -> None:
        """Withdraw an object, after those below it."""
        below = [each for each in self._objects if each == path or each.startswith(f"{path}/")]
        for each in sorted(below, key=len, reverse=True):
            interfaces = list(self._objects.pop(each))
            for key in [key for key in self._methods if key[0] == each]:
                del self._methods[key]
            self._signal("/", OBJECT_MANAGER, "InterfacesRemoved", "oas", [each, interfaces])

    def property(self, path: str, interface: str, name: str) -> object:
        """Return a property's value; None where it does not exist."""
        variant = self._objects.get(path, {}).get(interface, {}).get(name)
        return variant and variant.value

    def change(
        self, path: str, interface: str, changed: Properties, invalidated: Sequence[str] = ()
    ) -> None:
        """Set properties and tell everybody; without effect on an object that is gone."""
        if path in self._objects:
            properties = self._objects[path][interface]
            properties.update(changed)
            for name in invalidated:
                properties.pop(name, None)
            body = [interface, changed, list(invalidated)]
            self._signal(path, PROPERTIES, "PropertiesChanged", "sa{sv}as", body)

    def _signal(
        self, path: str, interface: str, member: str, signature: str, body: list[Any]
    ) -> None:
        if self._bus.connected:
            message = Message.new_signal(path, interface, member, signature, body)
            self._send(message)

    def _on_message(self, message: Message) -> bool | None:
        if message.message_type is not MessageType.METHOD_CALL:
            return None
        call = asyncio.ensure_future(self._answer(message))
        self._calls.add(call)
        call.add_done_callback(self._calls.discard)
        return True

    async def _answer(self, message: Message) -> None:
        try:
            reply = await self._call(message)
        except BluezError as error:
            answer = Message.new_error(message, error.name, error.text)
        else:
            signature, body = reply or ("", [])
            answer = Message.new_method_return(message, signature, body)
        await asyncio.sleep(self._late.pop(message.member or "", 0.0))
        if self._bus.connected:
            self._send(answer)

    async def _call(self, message: Message) -> Reply:
        path, interface, member = message.path or "", message.interface or "", message.member or ""
        if (interface, member) == (OBJECT_MANAGER, "GetManagedObjects"):
            return "a{oa{sa{sv}}}", [self._objects]
        if path not in self._objects:
            raise unknown_object(path)
        if (interface, member) == (PROPERTIES, "Set"):
            owner, name, value = message.body
            self.change(path, owner, {name: value})
            return None
        method = self._methods.get((path, interface, member))
        if method is None:
            raise failed(f"this BlueZ has no {interface}.{member}")
        return await method(message)
