"""One connection of a virtual adapter: the GATT client's side."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import AsyncExitStack
from typing import Protocol, TypeVar, cast

from bumble import att, core, hci
from bumble.device import Connection
from bumble.gatt import Characteristic
from bumble.gatt_client import CharacteristicProxy, DescriptorProxy, ServiceProxy

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)

_T = TypeVar("_T")
OnValue = Callable[[bytes], None]
_Properties = Characteristic.Properties
_COMMAND_HEADER = 3


class _GattClient(Protocol):
    """What is used of bumble's client, whose annotations leave type arguments out."""

    async def request_mtu(self, mtu: int) -> int: ...
    async def discover_services(self) -> list[ServiceProxy]: ...
    async def discover_characteristics(
        self, uuids: Sequence[str], service: ServiceProxy
    ) -> list[CharacteristicProxy[bytes]]: ...
    async def discover_descriptors(
        self, characteristic: CharacteristicProxy[bytes]
    ) -> list[DescriptorProxy]: ...
    async def read_value(self, attribute: int) -> bytes: ...
    async def write_value(self, attribute: int, value: bytes, with_response: bool) -> None: ...
    async def subscribe(
        self, characteristic: CharacteristicProxy[bytes], subscriber: OnValue
    ) -> None: ...
    async def unsubscribe(
        self, characteristic: CharacteristicProxy[bytes], subscriber: OnValue
    ) -> None: ...


class GattLink:
    """A connection whose services are known; made by `open`.

    Every request may raise ``bumble.att.ATT_Error`` when the device answers with an
    ATT error, TransportError ``LOST`` when the link is or gets lost, and ``SILENT``
    when the device does not answer within the 30 s of the ATT specification.

    Attributes
    ----------
    address
        Of the device.
    services
        With characteristics and descriptors.
    lost
        Whether the link is gone.
    on_lost
        Called when it goes, whoever ended it, before any request fails of it.
    """

    def __init__(self, connection: Connection) -> None:
        self.address = connection.peer_address.to_string(with_type_qualifier=False)
        self.services: list[ServiceProxy] = []
        # It may have gone between the event and this.
        self.lost = connection.device.lookup_connection(connection.handle) is not connection
        self.on_lost: list[Callable[[], None]] = []
        self._connection = connection
        self._client = cast("_GattClient", connection.gatt_client)
        self._on_value: dict[int, OnValue] = {}
        connection.on(Connection.EVENT_DISCONNECTION, self._on_disconnection)

    @classmethod
    async def open(cls, connection: Connection, mtu: int) -> GattLink:
        """Negotiate the MTU, encrypt if there is a bond, and discover everything.

        Raises
        ------
        TransportError
            ``LOST``. Whatever is raised, the connection has been ended.
        """
        link = cls(connection)
        preparing = asyncio.ensure_future(link._prepare(mtu))
        async with AsyncExitStack() as failed:
            failed.push_async_callback(link.disconnect)
            await asyncio.shield(preparing)
            failed.pop_all()
        return link

    @property
    def mtu(self) -> int:
        """The ATT MTU in use."""
        return self._connection.att_mtu

    @property
    def max_command_bytes(self) -> int:
        """How much fits into a write without response."""
        return self.mtu - _COMMAND_HEADER

    async def request(self, awaitable: Awaitable[_T]) -> _T:
        """Await something that the device has to answer."""
        if self.lost:
            if asyncio.iscoroutine(awaitable):
                awaitable.close()
            raise self._loss()
        try:
            return await self._connection.cancel_on_disconnection(awaitable)
        except asyncio.CancelledError:
            if self.lost:
                raise self._loss() from None
            raise
        except core.TimeoutError as error:
            message = f"{self.address} does not answer"
            raise TransportError(TransportReason.SILENT, message) from error

    async def read(self, attribute: CharacteristicProxy[bytes] | DescriptorProxy) -> bytes:
        """Read a value of any length."""
        # bumble's server does not check permissions, so its answer is given here.
        if not _has(attribute, _Properties.READ):
            raise att.ATT_Error(att.ErrorCode.READ_NOT_PERMITTED, attribute.handle)
        return await self.request(self._client.read_value(attribute.handle))

    async def write(
        self,
        attribute: CharacteristicProxy[bytes] | DescriptorProxy,
        data: bytes,
        *,
        response: bool,
    ) -> None:
        """Write a value; with response, one of any length.

        Raises
        ------
        ValueError
            If it is too long for a write without response.
        """
        if response and not _has(attribute, _Properties.WRITE):
            raise att.ATT_Error(att.ErrorCode.WRITE_NOT_PERMITTED, attribute.handle)
        if not response and len(data) > self.max_command_bytes:
            raise ValueError(f"{len(data)} bytes do not fit into an MTU of {self.mtu}")
        await self.request(self._client.write_value(attribute.handle, data, response))

    async def subscribe(
        self, characteristic: CharacteristicProxy[bytes], on_value: OnValue
    ) -> None:
        """Have notifications, or else indications, given to ``on_value`` from now on."""
        previous = self._on_value.pop(characteristic.handle, None)
        if previous:
            await self.request(self._client.unsubscribe(characteristic, previous))
        self._on_value[characteristic.handle] = on_value
        await self.request(self._client.subscribe(characteristic, on_value))

    async def unsubscribe(self, characteristic: CharacteristicProxy[bytes]) -> None:
        """Have no more of them; without effect where there are none."""
        if on_value := self._on_value.pop(characteristic.handle, None):
            await self.request(self._client.unsubscribe(characteristic, on_value))

    async def pair(self) -> None:
        """Pair (Just Works) and encrypt the link; without effect if it is encrypted.

        Raises
        ------
        ProtocolError
            ``REFUSED`` by the device.
        """
        if self._connection.is_encrypted:
            return
        try:
            await self.request(self._connection.pair())
        except core.ProtocolError as error:
            message = f"{self.address} refuses to pair"
            raise ProtocolError(ProtocolReason.REFUSED, message) from error

    async def unpair(self) -> None:
        """Forget the bond and disconnect."""
        await self._forget_bond()
        await self.disconnect()

    async def disconnect(self) -> None:
        """End the connection; without effect if it is gone, and not to be cancelled."""
        if not self.lost:
            await asyncio.shield(self._connection.disconnect())

    async def _prepare(self, mtu: int) -> None:
        await self.request(self._client.request_mtu(mtu))
        await self._use_bond()
        await self._discover()

    async def _use_bond(self) -> None:
        keys = self._connection.device.keystore
        if keys and await keys.get(str(self._connection.peer_address)):
            try:
                await self.request(self._connection.encrypt())
            except hci.HCI_Error:
                await self._forget_bond()

    async def _forget_bond(self) -> None:
        keys, address = self._connection.device.keystore, str(self._connection.peer_address)
        if keys and await keys.get(address):
            await keys.delete(address)

    async def _discover(self) -> None:
        self.services = await self.request(self._client.discover_services())
        for service in self.services:
            found = await self.request(self._client.discover_characteristics([], service))
            for characteristic in found:
                await self.request(self._client.discover_descriptors(characteristic))
                characteristic.descriptors_discovered = True

    def _loss(self) -> TransportError:
        return TransportError(TransportReason.LOST, f"{self.address} is disconnected")

    def _on_disconnection(self, _reason: int) -> None:
        self.lost = True
        for callback in list(self.on_lost):
            callback()


def _has(attribute: CharacteristicProxy[bytes] | DescriptorProxy, wanted: _Properties) -> bool:
    return isinstance(attribute, DescriptorProxy) or bool(attribute.properties & wanted)
