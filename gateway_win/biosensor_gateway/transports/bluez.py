"""Asks BlueZ for all devices that this computer knows, which bleak cannot.

Nothing here raises: on another system, or without BlueZ, there are no devices.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Mapping
from typing import Any, NamedTuple

from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.tap import is_replaced

_SERVICE = "org.bluez"
_DEVICE = "org.bluez.Device1"
_CHARACTERISTIC = "org.bluez.GattCharacteristic1"
_NOTIFIED = ("Notifying", "NotifyAcquired")
_TIMEOUT_S = 3.0


class KnownDevice(NamedTuple):
    """A device that is in range, connected, or paired."""

    path: str  # BlueZ's name of the device.
    advertisement: Advertisement  # Its latest advertisement.
    is_connected: bool  # To any program, including one that has ended.
    is_paired: bool
    # Whether a program is subscribed to its measurements, also during connection setup. BlueZ ends
    # the subscriptions of a program that has ended.
    is_listened_to: bool


async def known_devices() -> list[KnownDevice]:
    """List all devices that BlueZ knows."""
    body = await _call("/", "org.freedesktop.DBus.ObjectManager", "GetManagedObjects", "a{")
    objects: Mapping[str, Mapping[str, Any]] = body[0] if body else {}
    return [
        _known(path, interfaces[_DEVICE], _notifying(path, objects))
        for path, interfaces in objects.items()
        if "Address" in interfaces.get(_DEVICE, {})
    ]


async def disconnect(path: str) -> None:
    """End the connection to a device, made by any program; then it advertises again."""
    await _call(path, _DEVICE, "Disconnect", "")


def _notifying(path: str, objects: Mapping[str, Mapping[str, Any]]) -> bool:
    """Return whether any characteristic of a device has a subscriber."""
    below = [each for name, each in objects.items() if name.startswith(f"{path}/")]
    characteristics = [each[_CHARACTERISTIC] for each in below if _CHARACTERISTIC in each]
    return any(name in each and each[name].value for each in characteristics for name in _NOTIFIED)


def _known(path: str, properties: Mapping[str, Any], is_notifying: bool) -> KnownDevice:
    told = {name: variant.value for name, variant in properties.items()}
    advertisement = Advertisement(
        told["Address"],
        told.get("Name", ""),
        service_uuids=frozenset(told.get("UUIDs", ())),
        manufacturer_data={
            company: bytes(data.value) for company, data in told.get("ManufacturerData", {}).items()
        },
    )
    is_connected = bool(told.get("Connected"))
    is_being_set_up = is_connected and not told.get("ServicesResolved")
    return KnownDevice(
        path,
        advertisement,
        is_connected,
        is_paired=bool(told.get("Paired")),
        is_listened_to=is_notifying or is_being_set_up,
    )


async def _call(path: str, interface: str, member: str, signature: str) -> list[Any]:
    """Return BlueZ's answer; empty if there is none, or it is an error."""
    # What is replayed has nothing to do with the radio of this computer.
    if sys.platform != "linux" or is_replaced():
        return []
    from dbus_fast import BusType, DBusError, Message
    from dbus_fast.aio import MessageBus

    call = Message(destination=_SERVICE, path=path, interface=interface, member=member)
    try:
        async with asyncio.timeout(_TIMEOUT_S):
            bus = await MessageBus(bus_type=BusType.SYSTEM).connect()
            try:
                answer = await bus.call(call)
            finally:
                bus.disconnect()
    except (OSError, ValueError, DBusError, TimeoutError, EOFError):
        # No bus, nonsense as its address, or no BlueZ.
        return []
    return answer.body if answer.signature.startswith(signature) else []
