"""Connects to a Bluetooth LE device through bleak, with the same behaviour on every platform.

Platforms differ in the errors that they raise, in the calls that hang when the Bluetooth service
dies, and in whether a vanished device ends a pending request. Here every call ends within a known
time, with the same errors.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from typing import Any, NamedTuple, TypeAlias, TypeVar
from weakref import WeakKeyDictionary

from bleak import BleakClient
from bleak.args.winrt import WinRTClientArgs
from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.service import BleakGATTServiceCollection
from bleak.exc import BleakError
from bleak.uuids import normalize_uuid_str

from biosensor_common.errors import (
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.system.clock import LSL_CLOCK, Clock
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_errors import (
    Pairing,
    connect_error,
    is_forgotten,
    request_error,
)
from biosensor_gateway.transports.ble_scanner import Sighting, forget
from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.tap import Characteristic, LinkTap, What
from biosensor_gateway.transports.threads import in_background, outlasting, within

CONNECT_LIMIT_S = 20.0
REQUEST_LIMIT_S = 5.0
PAIR_LIMIT_S = 30.0

_T = TypeVar("_T")
_Asking: TypeAlias = Callable[[BleakClient], Coroutine[Any, Any, _T]]

# Radios fail when they have to make two connections at a time.
_connecting: WeakKeyDictionary[asyncio.AbstractEventLoop, asyncio.Lock] = WeakKeyDictionary()

CLOSE_LIMIT_S = 1.5
"""Leaves a driver half a second to say good-bye."""


async def _hang_up(
    client: BleakClient, attempt: asyncio.Task[None] | None, pairing: Pairing
) -> None:
    """Disconnect, and unpair if requested; never raises.

    Parameters
    ----------
    attempt
        The attempt to connect, which may still be running.
    """
    # Left to itself after a while: some calls never return when the service has died.
    ending = in_background(_disconnect(client, attempt, pairing))
    await asyncio.wait({ending}, timeout=CLOSE_LIMIT_S)


async def _disconnect(
    client: BleakClient, attempt: asyncio.Task[None] | None, pairing: Pairing
) -> None:
    if attempt is not None:
        # An attempt that was cancelled tidies up behind itself first.
        await asyncio.wait({attempt})
    if pairing.ends_with_connection:
        # Whatever comes of it, the connection has to end.
        with suppress(BleakError, NotImplementedError, OSError):
            await client.unpair()
        pairing.note_unpaired()
    await client.disconnect()


class _Characteristics:
    """Characteristics of one device, also after the link is lost; UUIDs have 16 or 128 bits."""

    def __init__(self) -> None:
        self._by_uuid: dict[str, BleakGATTCharacteristic] = {}

    def learn(self, services: BleakGATTServiceCollection) -> None:
        """Replace them by the device's present ones; of two with the same UUID, use the first."""
        self._by_uuid.clear()
        for service in services:
            for each in service.characteristics:
                self._by_uuid.setdefault(each.uuid.lower(), each)

    @property
    def table(self) -> Sequence[Characteristic]:
        """All of them, in the device's order."""
        return list(self._by_uuid.values())

    def find(self, uuid: str) -> BleakGATTCharacteristic | None:
        """Return a characteristic; None if the device does not have it."""
        return self._by_uuid.get(normalize_uuid_str(uuid))


class Notification(NamedTuple):
    """A value that the device sent without a request."""

    uuid: str  # Characteristic, 128-bit, lower case.
    data: bytes
    arrival: float  # LSL time of its arrival, in seconds.


class BleLink:
    """One connection to one device; create it in the event loop that uses it.

    UUIDs may be given with 16 or 128 bits.

    Parameters
    ----------
    choice
        The device; shared by all connections of a driver.
    clock
        The LSL clock.
    pairing
        Whether and when to pair; shared by all connections of a driver.
    """

    def __init__(
        self, choice: Choice, clock: Clock = LSL_CLOCK, *, pairing: Pairing | None = None
    ) -> None:
        self.clock = clock
        self._choice = choice
        self._pairing = pairing or Pairing()
        self._connected_s = 0.0
        self._client: BleakClient | None = None
        self._connected = False
        self._characteristics = _Characteristics()
        self._incoming: asyncio.Queue[Notification | None] = asyncio.Queue()
        self._lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._attempt: asyncio.Task[None] | None = None
        self._requesting = asyncio.Lock()
        self._tap = LinkTap(clock)

    @property
    def what(self) -> str:
        """Name of the device in messages."""
        return self._choice.what

    async def open(self) -> Advertisement:
        """Find the device and connect to it; return its advertisement.

        Raises
        ------
        TransportError
            ``ABSENT``, ``UNAVAILABLE``, ``BUSY``, ``DENIED`` or ``LOST``.
        ProtocolError
            ``REFUSED``: several devices are in range and none is selected.
        """
        try:
            seen = await self._find_and_connect()
        except GatewayError as error:
            self._tap.failed(error)
            raise
        self._choice.keep(seen)
        self._tap.opened(seen, self._characteristics.table)
        return seen

    def has(self, uuid: str) -> bool:
        """Whether the device has this characteristic; also after the link is lost."""
        return self._characteristics.find(uuid) is not None

    def properties(self, uuid: str) -> frozenset[str]:
        """Return a characteristic's properties: ``read``, ``notify``, ...; empty if unknown."""
        found = self._characteristics.find(uuid)
        return frozenset() if found is None else frozenset(found.properties)

    async def read(self, uuid: str) -> bytes:
        """Read a characteristic.

        Raises
        ------
        TransportError
            ``LOST``, or ``SILENT`` after 5 s, as for all other requests.
        AttError
            The device refused.
        ProtocolError
            ``UNSUPPORTED``: there is no such characteristic.
        """
        found = self._characteristic(uuid)
        with self._tap.asking(What.READ, found.uuid) as passed:
            passed.data = bytes(
                await self._request(lambda client: client.read_gatt_char(found), REQUEST_LIMIT_S)
            )
        return passed.data

    async def write(self, uuid: str, data: bytes, *, response: bool = True) -> None:
        """Write a characteristic; raises like :meth:`read`."""
        found = self._characteristic(uuid)
        with self._tap.asking(What.WRITTEN, found.uuid, data):
            await self._request(
                lambda client: client.write_gatt_char(found, data, response=response),
                REQUEST_LIMIT_S,
            )

    async def subscribe(self, uuid: str) -> None:
        """Make :meth:`next` return notifications or indications; raises like :meth:`read`."""
        found = self._characteristic(uuid)
        with self._tap.asking(What.SUBSCRIBED, found.uuid):
            await self._request(
                lambda client: client.start_notify(found, self._arrived), REQUEST_LIMIT_S
            )

    async def unsubscribe(self, uuid: str) -> None:
        """End a subscription; raises like :meth:`read`."""
        found = self._characteristic(uuid)
        with self._tap.asking(What.UNSUBSCRIBED, found.uuid):
            await self._request(lambda client: client.stop_notify(found), REQUEST_LIMIT_S)

    async def pair(self) -> None:
        """Pair without a PIN; no effect on macOS, which pairs automatically.

        Raises
        ------
        TransportError
            ``DENIED`` if it fails, ``LOST`` or ``SILENT``.
        AttError
            The device refused.
        """
        with self._tap.asking(What.PAIRED):
            await self._request(self._pair, PAIR_LIMIT_S, TransportReason.DENIED)

    async def next(self) -> Notification:
        """Wait for the next notification.

        Raises
        ------
        TransportError
            ``LOST``, after everything that had arrived was returned.
        """
        notification = await self._incoming.get()
        if notification is None:
            self._incoming.put_nowait(None)
            raise self._loss()
        return notification

    async def close(self) -> None:
        """Disconnect; never raises, and takes at most 1.5 s."""
        client, self._client = self._client, None
        self._tap.ended(What.CLOSED)
        self._end()
        if client is not None:
            await _hang_up(client, self._attempt, self._pairing)

    async def _find_and_connect(self) -> Advertisement:
        sighting = await self._choice.find()
        try:
            await self._connect(sighting)
        except BleakError:
            # The system forgot it between scan and connection.
            sighting = await self._choice.find()
            try:
                await self._connect(sighting)
            except BleakError as error:
                raise connect_error(self.what, error) from error
        return sighting.advertisement

    async def _connect(self, sighting: Sighting) -> None:
        """Raise like :meth:`open`, or a BleakError if the system forgot the device."""
        lock = _connecting.setdefault(asyncio.get_running_loop(), asyncio.Lock())
        async with lock:
            # Connected or not, what it said before does not hold any more.
            forget(sighting.device.address)
            client = BleakClient(
                sighting.device,
                disconnected_callback=self._disconnected,
                timeout=CONNECT_LIMIT_S,
                pair=self._pairing.comes_first,
                winrt=WinRTClientArgs()
                if self._pairing.uses_known_services
                else WinRTClientArgs(use_cached_services=False),
            )
            self._client = client
            self._attempt = in_background(client.connect())
            try:
                await within(CONNECT_LIMIT_S, self._attempt)
                if self._pairing.comes_first:
                    self._pairing.note_paired()
                self._begin(client)
            except Exception as error:  # turned into ours: backends raise what their system does
                self._client = None
                # The system may connect it yet, whatever it was told.
                self._choice.note_given_up()
                await _hang_up(client, self._attempt, self._pairing)
                if is_forgotten(error):
                    raise
                self._pairing.note_drop(0.0)
                raise connect_error(self.what, error) from error

    def _begin(self, client: BleakClient) -> None:
        """Save the characteristics, because bleak forgets them when the link is lost."""
        self._characteristics.learn(client.services)
        self._connected, self._connected_s = client.is_connected, self.clock()
        if not self._connected:
            raise BleakError("lost at once")

    def _characteristic(self, uuid: str) -> BleakGATTCharacteristic:
        found = self._characteristics.find(uuid)
        if found is None:
            message = f"{self.what}: the device has no characteristic {uuid}"
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        return found

    async def _request(
        self,
        ask: _Asking[_T],
        limit_s: float,
        failure: TransportReason = TransportReason.LOST,
    ) -> _T:
        client = self._client
        if client is None or self._lost.done():
            raise self._loss()
        is_asked = asyncio.Event()
        request = in_background(self._in_turn(client, ask, is_asked))
        try:
            return await outlasting(limit_s, request, unless=self._lost)
        except Exception as error:  # a request may fail with any error when the link is cut
            if self._lost.done() or not client.is_connected:
                raise self._loss() from error
            raise request_error(self.what, error, failure, limit_s) from error
        finally:
            if not is_asked.is_set():
                request.cancel()

    async def _in_turn(self, client: BleakClient, ask: _Asking[_T], is_asked: asyncio.Event) -> _T:
        # BlueZ and macOS refuse a request while another one is under way, given up or not.
        async with self._requesting:
            is_asked.set()
            return await ask(client)

    async def _pair(self, client: BleakClient) -> None:
        # macOS has no such call.
        with suppress(NotImplementedError):
            await client.pair()
        self._pairing.note_paired()

    def _loss(self) -> TransportError:
        message = f"{self.what}: the connection was cut; is the device on and near?"
        return TransportError(TransportReason.LOST, message)

    def _arrived(self, characteristic: BleakGATTCharacteristic, data: bytearray) -> None:
        arrival = self.clock()
        notification = Notification(characteristic.uuid.lower(), bytes(data), arrival)
        if self._tap.is_heard:
            self._tap.came(What.CAME, *notification)
        self._incoming.put_nowait(notification)

    def _disconnected(self, client: BleakClient) -> None:
        # Also called for attempts that fail, which bleak may repeat by itself.
        if self._connected and client is self._client:
            self._pairing.note_drop(self.clock() - self._connected_s)
            self._tap.ended(What.LOST)
            self._end()

    def _end(self) -> None:
        if not self._lost.done():
            self._lost.set_result(None)
            self._incoming.put_nowait(None)
