"""Objects on a D-Bus, and how BlueZ words what goes wrong (src/error.c, src/gatt-client.c)."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Protocol, cast

from bumble.att import ATT_Error
from dbus_fast.aio import MessageBus
from dbus_fast.constants import MessageType
from dbus_fast.message import Message
from dbus_fast.signature import Variant

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


_FAILED = "org.bluez.Error.Failed"
_ATT_ERRORS = {
    0x02: ("org.bluez.Error.NotPermitted", "Read not permitted"),
    0x03: ("org.bluez.Error.NotPermitted", "Write not permitted"),
    0x06: ("org.bluez.Error.NotSupported", "Not Supported"),
    0x07: ("org.bluez.Error.InvalidArguments", "Invalid offset"),
    0x08: ("org.bluez.Error.NotAuthorized", "Not Authorized"),
    0x0D: ("org.bluez.Error.InvalidArguments", "Invalid Length"),
    0xFD: ("org.bluez.Error.ImproperlyConfigured", "Improperly Configured"),
}
_UNLIKELY = 0x0E
# BlueZ does not pass these on as such. It tries to raise the link's security, which fails where
# no agent is registered, as on a machine without a desktop; then it words them, or nothing but
# the failure.
_INSUFFICIENT_SECURITY = frozenset({0x05, 0x0C, 0x0F})
_NOT_PAIRED = ("org.bluez.Error.NotPermitted", "Not paired")


class BluezError(Exception):
    """An error reply."""

    def __init__(self, name: str, text: str) -> None:
        super().__init__(name, text)
        self.name = name  # Of the D-Bus error.
        self.text = text


def failed(text: str) -> BluezError:
    """Return the error for everything that has no name of its own."""
    return BluezError(_FAILED, text)


def not_ready() -> BluezError:
    """Return the error of an adapter that is switched off."""
    return BluezError("org.bluez.Error.NotReady", "Resource Not Ready")


def not_connected() -> BluezError:
    """Return the error of a request to a device that is not connected."""
    return BluezError("org.bluez.Error.NotConnected", "Not Connected")


def in_progress() -> BluezError:
    """Return the error of something that was asked for already."""
    return BluezError("org.bluez.Error.InProgress", "Operation already in progress")


def not_supported() -> BluezError:
    """Return the error of a characteristic that cannot notify."""
    return BluezError("org.bluez.Error.NotSupported", "Operation is not supported")


def unknown_object(path: str) -> BluezError:
    """Return the error of an object that does not exist, or not any more."""
    return BluezError("org.freedesktop.DBus.Error.UnknownObject", f"No such object path '{path}'")


def att_error(error: ATT_Error, *, words_security: bool) -> BluezError:
    """Translate an ATT error response."""
    code = error.error_code
    if code in _INSUFFICIENT_SECURITY:
        if words_security:
            return BluezError(*_NOT_PAIRED)
        code = _UNLIKELY
    if code in _ATT_ERRORS:
        return BluezError(*_ATT_ERRORS[code])
    return failed(f"Operation failed with ATT error: 0x{code:02x}")


def request_lost() -> BluezError:
    """Return the error of a request during which the link went."""
    return failed(f"Operation failed with ATT error: 0x{_UNLIKELY:02x}")
