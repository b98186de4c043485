"""The radio and GATT server of one virtual Bluetooth LE device."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Protocol, cast

from bumble import att
from bumble.core import UUID
from bumble.device import Connection, Device
from bumble.gatt import (
    GATT_CLIENT_CHARACTERISTIC_CONFIGURATION_DESCRIPTOR as _SUBSCRIPTION,
)
from bumble.gatt import Characteristic, ClientCharacteristicConfigurationBits, Service
from bumble.gatt_server import Server
from bumble.hci import Address
from bumble.keys import MemoryKeyStore

from biosensor_gateway.simulation.advertising import pack_advertisement, pack_name
from biosensor_gateway.simulation.radio import MAX_MTU, Radio, Transceiver

# bumble's emulated advertiser takes its interval, counted in 0.625 ms, for milliseconds.
_BUMBLE_UNITS = 0.625
_NOTIFICATION_HEADER = 3
_Bits = ClientCharacteristicConfigurationBits
_AUTHENTICATED = (
    att.Attribute.Permissions.READ_REQUIRES_AUTHENTICATION
    | att.Attribute.Permissions.WRITE_REQUIRES_AUTHENTICATION
)
Protected = tuple[Service, Characteristic[bytes]]
"""A characteristic that requires authentication, behind its service."""


class Bundles:
    """Sends notifications at once, or has them wait for each other.

    Parameters
    ----------
    connection
        Returns the one that stands.
    """

    def __init__(self, connection: Callable[[], Connection | None]) -> None:
        self._connection = connection
        self._wait_s = 0.0
        self._waiting: list[tuple[Connection, bytes]] = []

    def wait(self, seconds: float) -> None:
        """Have them wait for so long and come together; 0 sends them at once."""
        self._wait_s = seconds
        if not seconds:
            self.flush()

    def send(self, connection: Connection, pdu: bytes) -> None:
        """Send one, now or later."""
        if not self._wait_s:
            connection.send_l2cap_pdu(att.ATT_CID, pdu)
            return
        if not self._waiting:
            asyncio.get_running_loop().call_later(self._wait_s, self.flush)
        self._waiting.append((connection, pdu))

    def flush(self) -> None:
        """Send those that wait, if their host is still there."""
        waiting, self._waiting = self._waiting, []
        for connection, pdu in waiting:
            if connection is self._connection():
                connection.send_l2cap_pdu(att.ATT_CID, pdu)


class Peripheral:
    """One device on the air; every method is for the world's loop.

    Flags, service UUIDs and manufacturer data are advertised, the complete local
    name comes in the scan response. While connected it does not advertise.

    Parameters
    ----------
    radio
        The air.
    address
        Its own Bluetooth address, six pairs of hexadecimal digits with colons.
    name
        The complete local name.
    service_uuids
        Those advertised: 16 bits as ``"180d"``, or 128 bits.
    manufacturer_data
        By company identifier.
    rssi_dbm
        How strong hosts hear it.
    max_mtu
        The largest ATT MTU that it grants.
    interval_ms
        So often it advertises.

    Attributes
    ----------
    on_connected, on_disconnected
        Called in the world's loop.
    bundles: where notifications may wait for each other.
    demand_pairing
        Whether the characteristics whose permissions contain
        ``READ_REQUIRES_AUTHENTICATION`` or ``WRITE_REQUIRES_AUTHENTICATION`` answer
        ATT error 0x05 until the host has paired (subscribing counts as writing).
        Counts from the next connection on; off, these permissions mean nothing.
    """

    def __init__(
        self,
        radio: Radio,
        address: str,
        name: str,
        *,
        service_uuids: Sequence[str] = (),
        manufacturer_data: Mapping[int, bytes] | None = None,
        rssi_dbm: int = -58,
        max_mtu: int = MAX_MTU,
        interval_ms: float = 50.0,
    ) -> None:
        self.address = address
        self.name = name
        self._interval = interval_ms * _BUMBLE_UNITS
        self.on_connected: list[Callable[[], None]] = []
        self.on_disconnected: list[Callable[[], None]] = []
        self.demand_pairing = False
        self._radio = radio
        self.clock = radio.world.clock
        self._uuids = [UUID(uuid) for uuid in service_uuids]
        self._rssi_dbm = rssi_dbm
        self._max_mtu = max_mtu
        self._bonds = MemoryKeyStore()
        self._transceiver: Transceiver | None = None
        self._device: Device | None = None
        self._connection: Connection | None = None
        self._advertising = True
        self._dropped = False
        self._breaking = False
        self._stalled = False
        self._address_on_air = address
        self._scan_response = pack_name(name)
        self.bundles = Bundles(lambda: self._connection)
        self._indications = Indications(self._can_indicate)
        self._services: Sequence[Service] = ()
        self._denied: frozenset[UUID] = frozenset()
        self._advertisement = pack_advertisement(self._uuids, manufacturer_data or {})

    @property
    def connected(self) -> bool:
        """Whether a host is connected."""
        return self._connection is not None

    @property
    def is_heard(self) -> bool:
        """Whether it is on the air, for whoever listens."""
        return self._transceiver is not None and self._transceiver.audible

    @property
    def rssi_dbm(self) -> int:
        """How strong hosts hear it [dBm]."""
        return self._rssi_dbm

    @property
    def host_mtu(self) -> int:
        """The ATT MTU in use; 23 while nobody is connected."""
        return self._connection.att_mtu if self._connection else att.ATT_DEFAULT_MTU

    @property
    def stalled(self) -> bool:
        """Whether nothing is sent or heard although the link stands; settable.

        What the host asks meanwhile is answered when this ends, as a link layer
        delivers late rather than never.
        """
        return self._stalled

    @stalled.setter
    def stalled(self, stalled: bool) -> None:
        self._stalled = stalled
        if self._transceiver:
            self._transceiver.stalled = stalled
        self._update_audible()

    async def power_on(self, services: Sequence[Service]) -> None:
        """Switch on with this GATT table, and advertise.

        Raises
        ------
        ValueError
            If pairing is demanded but no characteristic asks for it, or if it is on.
        """
        if self._device:
            raise ValueError(f"{self.name} is already switched on")
        protected = protected_characteristics(services)
        if self.demand_pairing and not protected:
            raise ValueError(f"no characteristic of {self.name} requires authentication")
        transceiver = Transceiver(self.name, self._radio.air)
        transceiver.rssi_dbm = self._rssi_dbm
        transceiver.stalled = self._stalled
        self._transceiver = transceiver
        self._update_audible()
        device = await self._radio.power_on(
            transceiver, self.name, self._address_on_air, self._bonds
        )
        self._device = device
        device.gatt_server.max_mtu = self._max_mtu
        self._services = services
        device.add_services(services)
        protect_subscriptions(device.gatt_server, protected)
        self.deny(self._denied)
        device.on(Device.EVENT_CONNECTION, self._on_connection)
        await device.start_advertising(
            auto_restart=True,
            advertising_data=self._advertisement,
            scan_response_data=self._scan_response,
            advertising_interval_min=self._interval,
            advertising_interval_max=self._interval,
        )

    async def power_off(self) -> None:
        """Switch off: the link is lost, and nothing is on the air.

        What `notify` accepted before still arrives.
        """
        if self._device and self._transceiver:
            device, self._device = self._device, None
            if self._connection:
                await self._connection.drain()
            transceiver, self._transceiver = self._transceiver, None
            await self._radio.power_off(transceiver, device)
            if self._connection:
                self._on_disconnection(self._connection)
            await self._indications.ended()

    def subscribed(self, characteristic: Characteristic[bytes]) -> bool:
        """Whether the host wants notifications or indications of this."""
        return self._subscription(characteristic) != _Bits.DEFAULT

    def forget_subscription(self, characteristic: Characteristic[bytes]) -> None:
        """Take it that the connected host has never subscribed to this."""
        if self._device and self._connection:
            subscribers = self._device.gatt_server.subscribers.get(self._connection, {})
            subscribers.pop(characteristic.handle, None)

    async def notify(self, characteristic: Characteristic[bytes], value: bytes) -> bool:
        """Send a notification, or an indication and wait until it is confirmed.

        Returns
        -------
        bool
            Whether it was sent; a host that stays connected gets it for certain, and of an
            indication that is cut off only the confirmation is missing.

        Raises
        ------
        ValueError
            If the value does not fit into one packet.
        """
        bits = self._subscription(characteristic)
        connection = self._connection
        if not connection or self._breaking or self._stalled or bits == _Bits.DEFAULT:
            return False
        if len(value) > connection.att_mtu - _NOTIFICATION_HEADER:
            raise ValueError(f"{len(value)} bytes do not fit into an MTU of {connection.att_mtu}")
        if bits & _Bits.NOTIFICATION:
            notification = att.ATT_Handle_Value_Notification(
                attribute_handle=characteristic.handle, attribute_value=value
            )
            self.bundles.send(connection, bytes(notification))
            return True
        return await self._indications.send(connection, characteristic, value)

    def deny(self, uuids: Iterable[UUID]) -> None:
        """Let nobody read these characteristics or subscribe to them, and again all others."""
        self._denied = frozenset(uuids)
        if self._device:
            deny_characteristics(self._device.gatt_server, self._services, self._denied)

    def set_nameless(self, nameless: bool) -> None:
        """Advertise no name from now on, or the name again."""
        self._scan_response = b"" if nameless else pack_name(self.name)
        if self._device and self._transceiver:
            self._device.scan_response_data = self._scan_response
            self._transceiver.le_legacy_advertiser.scan_response_data = self._scan_response

    def set_address(self, address: str) -> None:
        """Be on the air under this address from now on; a connection to another one is lost."""
        self._address_on_air = address
        if self._connection:
            self.drop()
            self._dropped = False
        else:
            self._take_address()

    def set_advertising(self, on: bool) -> None:
        """Advertise, when not connected, or do not."""
        self._advertising = on
        self._update_audible()

    def set_rssi(self, dbm: int) -> None:
        """Come closer or go away."""
        self._rssi_dbm = dbm
        if self._transceiver:
            self._transceiver.rssi_dbm = dbm

    def set_manufacturer_data(self, manufacturer_data: Mapping[int, bytes]) -> None:
        """Advertise other manufacturer data from now on."""
        self._advertisement = pack_advertisement(self._uuids, manufacturer_data)
        if self._device and self._transceiver:
            self._device.advertising_data = self._advertisement
            self._transceiver.le_legacy_advertiser.advertising_data = self._advertisement

    def drop(self) -> None:
        """Lose the link as by supervision timeout; not on the air until `restore`.

        What `notify` accepted before still arrives.
        """
        self._dropped = True
        self.bundles.flush()
        self._update_audible()
        if self._connection:
            self._breaking = True
            self._break_when_sent()

    def restore(self) -> None:
        """Be on the air again."""
        self._dropped = False
        self._update_audible()

    def _take_address(self) -> None:
        if self._device and self._transceiver:
            self._device.random_address = self._transceiver.random_address = Address(
                self._address_on_air
            )
        self._update_audible()

    def _break_when_sent(self) -> None:
        connection, transceiver = self._connection, self._transceiver
        if not connection or not transceiver:
            return
        queue = connection.data_packet_queue
        if queue and queue.pending:
            asyncio.get_running_loop().call_soon(self._break_when_sent)
        else:
            transceiver.lose_links()

    def _can_indicate(self, connection: Connection, characteristic: Characteristic[bytes]) -> bool:
        is_linked = self._connection is connection and not self._breaking and not self._stalled
        return is_linked and bool(self._subscription(characteristic) & _Bits.INDICATION)

    def _subscription(self, characteristic: Characteristic[bytes]) -> int:
        if not self._device or not self._connection:
            return _Bits.DEFAULT
        subscribers = self._device.gatt_server.subscribers.get(self._connection, {})
        return int.from_bytes(subscribers.get(characteristic.handle, b""), "little")

    def _update_audible(self) -> None:
        if self._transceiver:
            self._transceiver.audible = (
                self._advertising and not self._dropped and not self._stalled
            )

    def _on_connection(self, connection: Connection) -> None:
        # What is authenticated already answers every host.
        connection.authenticated = not self.demand_pairing
        self._connection = connection
        connection.on(Connection.EVENT_DISCONNECTION, partial(self._on_disconnection, connection))
        for callback in list(self.on_connected):
            callback()

    def _on_disconnection(self, connection: Connection, _reason: int = 0) -> None:
        if self._connection is not connection:
            return
        self._connection = None
        self._breaking = False
        self._take_address()
        self._indications.give_up()
        for callback in list(self.on_disconnected):
            callback()


class Indications:
    """Puts one after the other on the link, and tells of each whether it got there.

    For the world's loop.

    Parameters
    ----------
    may_send
        Whether the device can still send this on that connection.
    """

    def __init__(self, may_send: Callable[[Connection, Characteristic[bytes]], bool]) -> None:
        self._may_send = may_send
        self._unconfirmed = asyncio.Lock()
        self._under_way: set[asyncio.Task[None]] = set()

    async def send(
        self, connection: Connection, characteristic: Characteristic[bytes], value: bytes
    ) -> bool:
        """Indicate a value, and wait until it is confirmed or the link has ended.

        Returns
        -------
        bool
            Whether it was put on the link. The host has it then, also where its confirmation
            is held up or cut off.
        """
        was_put_out = False

        async def indicate() -> None:
            nonlocal was_put_out
            async with self._unconfirmed:
                # It may have waited for another one, and the device have stopped meanwhile.
                if self._may_send(connection, characteristic):
                    was_put_out = True
                    server = connection.gatt_server
                    await server.indicate_subscriber(connection, characteristic, value)

        task = asyncio.create_task(indicate())
        self._under_way.add(task)
        task.add_done_callback(self._under_way.discard)
        try:
            await asyncio.wait({task})
        finally:
            # Without effect unless the sender itself is to end.
            task.cancel()
        if task.cancelled():
            # What bumble notes of a connection that has ended would stay.
            connection.gatt_server.on_disconnection(connection)
        else:
            task.result()
        return was_put_out

    def give_up(self) -> None:
        """Wait for no confirmation any more: the link has ended."""
        for task in self._under_way:
            task.cancel()

    async def ended(self) -> None:
        """Return when each sender knows what became of its own, after `give_up`."""
        if self._under_way:
            await asyncio.wait(self._under_way)


class _Table(Protocol):
    """What is used of bumble's service, whose annotation leaves a type argument out."""

    characteristics: list[Characteristic[bytes]]


def protected_characteristics(services: Sequence[Service]) -> list[Protected]:
    """Return the characteristics that require authentication, with their services."""
    every = ((service, c) for service in services for c in cast("_Table", service).characteristics)
    return [(service, c) for service, c in every if c.permissions & _AUTHENTICATED]


def protect_subscriptions(server: Server, protected: Iterable[Protected]) -> None:
    """Ask of who subscribes to these characteristics what reading and writing them asks."""
    for service, characteristic in protected:
        # bumble makes the descriptor by itself, open to everybody.
        subscription = server.get_descriptor_attribute(
            service.uuid, characteristic.uuid, _SUBSCRIPTION
        )
        if subscription:
            subscription.permissions |= characteristic.permissions & _AUTHENTICATED


_DENIED = att.Attribute.Permissions.READ_REQUIRES_AUTHORIZATION
_UNWRITEABLE = att.Attribute.Permissions.WRITE_REQUIRES_AUTHORIZATION


def deny_characteristics(
    server: Server, services: Iterable[Service], denied: frozenset[UUID]
) -> None:
    """Answer who reads these characteristics or subscribes to them with an ATT error, 0x08."""
    for service in services:
        for characteristic in cast("_Table", service).characteristics:
            subscription = server.get_descriptor_attribute(
                service.uuid, characteristic.uuid, _SUBSCRIPTION
            )
            is_denied = characteristic.uuid in denied
            set_permission(characteristic, _DENIED, on=is_denied)
            if subscription:
                set_permission(subscription, _UNWRITEABLE, on=is_denied)


def set_permission(
    attribute: att.Attribute[bytes], permission: att.Attribute.Permissions, *, on: bool
) -> None:
    """Set or clear one permission of an attribute."""
    if on:
        attribute.permissions |= permission
    else:
        attribute.permissions &= ~permission
