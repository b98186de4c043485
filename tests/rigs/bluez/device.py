"""A device that BlueZ knows: org.bluez.Device1."""

from __future__ import annotations

import asyncio
from math import inf
from typing import TYPE_CHECKING

from dbus_fast.message import Message
from dbus_fast.signature import Variant

from biosensor_common.errors import GatewayError
from biosensor_gateway.simulation.advertising import Advertised
from biosensor_gateway.simulation.central import GattLink, Heard
from tests.rigs.bluez.errors import (
    BluezError,
    failed,
    in_progress,
    not_connected,
    not_ready,
)
from tests.rigs.bluez.gatt import GattObjects
from tests.rigs.bluez.objects import Method, Properties, Reply

if TYPE_CHECKING:
    from tests.rigs.bluez.adapter import FakeBluez

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
