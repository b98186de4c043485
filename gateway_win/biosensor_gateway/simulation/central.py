"""A virtual Bluetooth LE adapter of a computer: scans, connections, GATT requests.

Host stacks are built on it: a bleak backend and a fake BlueZ. Everything runs in the world's event
loop.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from contextlib import AsyncExitStack
from typing import Any, NamedTuple, Protocol, TypeVar, cast

from bumble import att, core, hci
from bumble.device import Connection, Device
from bumble.gatt import Characteristic
from bumble.gatt_client import CharacteristicProxy, DescriptorProxy, ServiceProxy

from biosensor_common.errors import ProtocolError, ProtocolReason, TransportError, TransportReason
from biosensor_gateway.simulation.radio import Radio

_T = TypeVar("_T")
OnValue = Callable[[bytes], None]
_Properties = Characteristic.Properties
_COMMAND_HEADER = 3


async def uncancelled(awaitable: Awaitable[_T]) -> _T:
    """Wait for a task that continues if the waiting is cancelled; its error is then ignored."""
    task = asyncio.ensure_future(awaitable)
    task.add_done_callback(_look_at)
    return await asyncio.shield(task)


def _look_at(ended: asyncio.Future[Any]) -> None:
    if not ended.cancelled():
        # Else the event loop reports the error of what was given up.
        ended.exception()


class _GattClient(Protocol):
    """The used part of bumble's client, whose annotations lack type arguments."""

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
    """A connection with discovered services, created by `open`.

    Every request may raise ``bumble.att.ATT_Error`` if the device answers with an ATT error,
    TransportError ``LOST`` if the link is lost, and ``SILENT`` if the device does not answer
    within the 30 s of the ATT specification.
    """

    def __init__(self, connection: Connection) -> None:
        self.address = connection.peer_address.to_string(with_type_qualifier=False)
        self.services: list[ServiceProxy] = []  # Services with characteristics and descriptors.
        # The link may have been lost since the event.
        self.lost = connection.device.lookup_connection(connection.handle) is not connection
        # Called when the link ends for any reason, before requests fail.
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
            ``LOST``. After any error, the connection has been closed.
        """
        link = cls(connection)
        async with AsyncExitStack() as failed:
            failed.push_async_callback(link.disconnect)
            await uncancelled(link._prepare(mtu))
            failed.pop_all()
        return link

    @property
    def mtu(self) -> int:
        """The ATT MTU in use."""
        return self._connection.att_mtu

    @property
    def max_command_bytes(self) -> int:
        """Maximum size of a write without response."""
        return self.mtu - _COMMAND_HEADER

    async def request(self, awaitable: Awaitable[_T]) -> _T:
        """Wait for an answer of the device."""
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
        # bumble's server does not check this property, so the error is raised here.
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
        """Subscribe to notifications, or else indications, with ``on_value`` as callback."""
        previous = self._on_value.pop(characteristic.handle, None)
        if previous:
            await self.request(self._client.unsubscribe(characteristic, previous))
        self._on_value[characteristic.handle] = on_value
        await self.request(self._client.subscribe(characteristic, on_value))

    async def unsubscribe(self, characteristic: CharacteristicProxy[bytes]) -> None:
        """Unsubscribe, if subscribed."""
        if on_value := self._on_value.pop(characteristic.handle, None):
            await self.request(self._client.unsubscribe(characteristic, on_value))

    async def pair(self) -> None:
        """Pair (Just Works) and encrypt the link, unless it is encrypted.

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
        """Delete the bond and disconnect."""
        await self._forget_bond()
        await self.disconnect()

    async def disconnect(self) -> None:
        """End the connection if it still exists; cannot be cancelled."""
        if not self.lost:
            await uncancelled(self._connection.disconnect())

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


# Time within which a device just received connects, unless it is gone.
_CONNECT_S = 1.0


class Heard(NamedTuple):
    """One advertisement or scan response."""

    address: str
    data: bytes  # Its payload, undecoded.
    rssi_dbm: int
    is_response: bool


Listener = Callable[[Heard], None]


class _Events(Protocol):
    def remove_listener(self, event: str, f: Callable[..., object]) -> None: ...


class Central:
    """One adapter, with any number of concurrent scans and links.

    Parameters
    ----------
    radio
        The radio, which also determines whether the adapter is on.
    device
        From ``radio.host()``.
    """

    def __init__(self, radio: Radio, device: Device) -> None:
        self.radio = radio
        self._device = device
        self._listeners: list[Listener] = []
        self._scan_lock = asyncio.Lock()
        self._connect_lock = asyncio.Lock()
        self._tasks: set[asyncio.Task[Any]] = set()
        radio.on_switched_off.append(self._listeners.clear)
        # bumble would combine advertisement and scan response, but host stacks do that themselves.
        events = cast("_Events", device.host)
        events.remove_listener("advertising_report", device.on_advertising_report)
        device.host.on("advertising_report", self._on_report)

    @classmethod
    async def on_the_air(cls, radio: Radio) -> Central:
        """Return an adapter that is on."""
        return cls(radio, await radio.host())

    async def close(self) -> None:
        """Switch off; links are lost and scans end."""
        self.radio.on_switched_off.remove(self._listeners.clear)
        self._listeners.clear()
        await self.radio.release(self._device)

    def require_power(self) -> None:
        """Raise an error if Bluetooth is switched off.

        Raises
        ------
        TransportError
            ``UNAVAILABLE``.
        """
        if not self.radio.available:
            raise TransportError(TransportReason.UNAVAILABLE, "Bluetooth is switched off")

    async def listen(self, listener: Listener) -> None:
        """Start an active scan; the listener gets all advertisements and scan responses.

        Raises
        ------
        TransportError
            ``UNAVAILABLE`` if Bluetooth is switched off.
        """
        self.require_power()
        self._listeners.append(listener)
        try:
            await self._uncancelled(self._update_scan())
        except asyncio.CancelledError:
            self._listeners.remove(listener)
            raise

    async def unlisten(self, listener: Listener) -> None:
        """End a scan, if there is one."""
        if listener in self._listeners:
            self._listeners.remove(listener)
        await self._uncancelled(self._update_scan())

    async def wait_for(self, address: str) -> None:
        """Wait until a device is received; cancel it to give up.

        Raises
        ------
        TransportError
            ``UNAVAILABLE`` if Bluetooth is switched off.
        """
        found = asyncio.Event()

        def listener(heard: Heard) -> None:
            if heard.address == address.upper():
                found.set()

        await self.listen(listener)
        self.radio.on_switched_off.append(found.set)
        try:
            await found.wait()
        finally:
            self.radio.on_switched_off.remove(found.set)
            await self.unlisten(listener)
        self.require_power()

    async def connect(self, address: str) -> GattLink:
        """Connect as soon as the device is received, and discover its services.

        It waits without a limit; cancel it to give up.

        Raises
        ------
        TransportError
            ``UNAVAILABLE`` if Bluetooth is switched off, ``LOST`` if the link was lost during the
            discovery of services.
        """
        while True:
            await self.wait_for(address)
            attempt = self._spawn(self._establish(address))
            try:
                connection = await asyncio.shield(attempt)
            except asyncio.CancelledError:
                attempt.add_done_callback(self._abandon)
                raise
            if connection:
                return await GattLink.open(connection, self.radio.host_mtu)

    async def _establish(self, address: str) -> Connection | None:
        async with self._connect_lock:
            try:
                return await self._device.connect_le(hci.Address(address), timeout=_CONNECT_S)
            except (core.ConnectionError, core.TimeoutError):
                return None

    def _abandon(self, attempt: asyncio.Future[Connection | None]) -> None:
        if not attempt.cancelled() and (connection := attempt.result()):
            self._spawn(connection.disconnect())

    async def _uncancelled(self, coroutine: Coroutine[Any, Any, None]) -> None:
        # bumble does not tolerate the cancellation of a command to the controller.
        await uncancelled(self._spawn(coroutine))

    def _spawn(self, coroutine: Coroutine[Any, Any, _T]) -> asyncio.Task[_T]:
        task = asyncio.ensure_future(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def _update_scan(self) -> None:
        async with self._scan_lock:
            if self._listeners and not self._device.scanning:
                await self._device.start_scanning()
            elif not self._listeners and self._device.scanning:
                await self._device.stop_scanning()

    def _on_report(self, report: hci.HCI_LE_Advertising_Report_Event.Report) -> None:
        response = report.event_type == hci.HCI_LE_Advertising_Report_Event.EventType.SCAN_RSP
        address = report.address.to_string(with_type_qualifier=False)
        heard = Heard(address, report.data, report.rssi, response)
        for listener in list(self._listeners):
            listener(heard)
