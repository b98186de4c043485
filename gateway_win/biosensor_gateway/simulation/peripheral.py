"""The radio and GATT server of one virtual Bluetooth LE device."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

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

from biosensor_gateway.simulation.radio import (
    MAX_MTU,
    Radio,
    Transceiver,
    pack_advertisement,
    pack_name,
)

# bumble's emulated advertiser treats its interval, in units of 0.625 ms, as milliseconds.
_BUMBLE_UNITS = 0.625
_NOTIFICATION_HEADER = 3
_Bits = ClientCharacteristicConfigurationBits
_AUTHENTICATED = (
    att.Attribute.Permissions.READ_REQUIRES_AUTHENTICATION
    | att.Attribute.Permissions.WRITE_REQUIRES_AUTHENTICATION
)
Protected = tuple[Service, Characteristic[bytes]]
"""A characteristic that requires authentication, with its service."""


class Bundles:
    """Sends notifications at once, or delayed and together."""

    def __init__(self, connection: Callable[[], Connection | None]) -> None:
        self._connection = connection
        self._wait_s = 0.0
        self._waiting: list[tuple[Connection, bytes]] = []

    def wait(self, seconds: float) -> None:
        """Delay notifications by up to this time and send them together; 0 for no delay."""
        self._wait_s = seconds
        if not seconds:
            self.flush()

    def send(self, connection: Connection, pdu: bytes) -> None:
        """Send a notification, now or later."""
        if not self._wait_s:
            connection.send_l2cap_pdu(att.ATT_CID, pdu)
            return
        if not self._waiting:
            asyncio.get_running_loop().call_later(self._wait_s, self.flush)
        self._waiting.append((connection, pdu))

    def flush(self) -> None:
        """Send waiting notifications, if their host is still connected."""
        waiting, self._waiting = self._waiting, []
        for connection, pdu in waiting:
            if connection is self._connection():
                connection.send_l2cap_pdu(att.ATT_CID, pdu)


class Peripheral:
    """One device with its radio; all methods must run in the world's event loop.

    Flags, service UUIDs and manufacturer data are advertised; the complete local name is in the
    scan response. While connected it does not advertise.

    Parameters
    ----------
    address
        Its Bluetooth address, six pairs of hexadecimal digits with colons.
    name
        The complete local name.
    service_uuids
        Advertised UUIDs: 16 bits such as ``"180d"``, or 128 bits.
    manufacturer_data
        Manufacturer data by company identifier.
    rssi_dbm
        Signal strength as received by hosts.
    max_mtu
        Largest ATT MTU that it accepts.
    interval_ms
        Interval between advertisements.

    Attributes
    ----------
    bundles: sends notifications, possibly delayed. demand_pairing
        Whether characteristics with the permissions ``READ_REQUIRES_AUTHENTICATION`` or
        ``WRITE_REQUIRES_AUTHENTICATION`` answer ATT error 0x05 until the host has paired
        (subscribing counts as writing). Takes effect with the next connection; if off, these
        permissions have no effect.
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
        # on_connected, on_disconnected: called in the world's event loop.
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
        """Whether hosts can receive it."""
        return self._transceiver is not None and self._transceiver.audible

    @property
    def rssi_dbm(self) -> int:
        """Signal strength as received by hosts [dBm]."""
        return self._rssi_dbm

    @property
    def host_mtu(self) -> int:
        """The ATT MTU in use; 23 without a connection."""
        return self._connection.att_mtu if self._connection else att.ATT_DEFAULT_MTU

    @property
    def stalled(self) -> bool:
        """Whether nothing is sent or received although the link is up; settable.

        Requests received meanwhile are answered when this ends, because a link layer delivers late
        rather than never.
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
            If pairing is demanded but no characteristic requires it, or if it is on.
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
        """Switch off, which ends the link and advertising.

        Values already accepted by `notify` still arrive.
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
        """Whether the host is subscribed to notifications or indications."""
        return self._subscription(characteristic) != _Bits.DEFAULT

    def forget_subscription(self, characteristic: Characteristic[bytes]) -> None:
        """Forget the connected host's subscription."""
        if self._device and self._connection:
            subscribers = self._device.gatt_server.subscribers.get(self._connection, {})
            subscribers.pop(characteristic.handle, None)

    async def notify(self, characteristic: Characteristic[bytes], value: bytes) -> bool:
        """Send a notification, or send an indication and wait for its confirmation.

        Returns
        -------
        bool
            Whether it was sent. A host that stays connected certainly gets it; if an indication is
            interrupted, only its confirmation is missing.

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
        """Deny reads of and subscriptions to these characteristics only."""
        self._denied = frozenset(uuids)
        if self._device:
            deny_characteristics(self._device.gatt_server, self._services, self._denied)

    def set_nameless(self, nameless: bool) -> None:
        """Stop or resume advertising the name."""
        self._scan_response = b"" if nameless else pack_name(self.name)
        if self._device and self._transceiver:
            self._device.scan_response_data = self._scan_response
            self._transceiver.le_legacy_advertiser.scan_response_data = self._scan_response

    def set_address(self, address: str) -> None:
        """Change the address; a connection to another address is lost."""
        self._address_on_air = address
        if self._connection:
            self.drop()
            self._dropped = False
        else:
            self._take_address()

    def set_advertising(self, on: bool) -> None:
        """Switch advertising on or off."""
        self._advertising = on
        self._update_audible()

    def set_manufacturer_data(self, manufacturer_data: Mapping[int, bytes]) -> None:
        """Change the advertised manufacturer data."""
        self._advertisement = pack_advertisement(self._uuids, manufacturer_data)
        if self._device and self._transceiver:
            self._device.advertising_data = self._advertisement
            self._transceiver.le_legacy_advertiser.advertising_data = self._advertisement

    def drop(self) -> None:
        """Lose the link by supervision timeout; out of range until `restore`.

        Values already accepted by `notify` still arrive.
        """
        self._dropped = True
        self.bundles.flush()
        self._update_audible()
        if self._connection:
            self._breaking = True
            self._break_when_sent()

    def restore(self) -> None:
        """Move it back into range."""
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
        # An authenticated connection may access all characteristics.
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
    """Sends indications one at a time, and reports whether each was sent.

    All methods must run in the world's event loop.

    Parameters
    ----------
    may_send
        Returns whether the device can still send on that connection.
    """

    def __init__(self, may_send: Callable[[Connection, Characteristic[bytes]], bool]) -> None:
        self._may_send = may_send
        self._unconfirmed = asyncio.Lock()
        self._under_way: set[asyncio.Task[None]] = set()

    async def send(
        self, connection: Connection, characteristic: Characteristic[bytes], value: bytes
    ) -> bool:
        """Send an indication, and wait until it is confirmed or the link has ended.

        Returns
        -------
        bool
            Whether it was sent; the host has received it then, even if the confirmation is delayed
            or lost.
        """
        was_put_out = False

        async def indicate() -> None:
            nonlocal was_put_out
            async with self._unconfirmed:
                # The device may have stopped while this waited for another indication.
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
            # No effect unless the sender itself is cancelled.
            task.cancel()
        if task.cancelled():
            # Otherwise bumble would keep data of the ended connection.
            connection.gatt_server.on_disconnection(connection)
        else:
            task.result()
        return was_put_out

    def give_up(self) -> None:
        """Stop waiting for confirmations, because the link has ended."""
        for task in self._under_way:
            task.cancel()

    async def ended(self) -> None:
        """After `give_up`, wait until all senders have their result."""
        if self._under_way:
            await asyncio.wait(self._under_way)


def _characteristics(service: Service) -> list[Characteristic[bytes]]:
    # Bumble's annotation lacks the type argument.
    return service.characteristics  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]


def protected_characteristics(services: Sequence[Service]) -> list[Protected]:
    """Return the characteristics that require authentication, with their services."""
    every = ((service, c) for service in services for c in _characteristics(service))
    return [(service, c) for service, c in every if c.permissions & _AUTHENTICATED]


def protect_subscriptions(server: Server, protected: Iterable[Protected]) -> None:
    """Apply the read and write permissions of these characteristics to subscriptions."""
    for service, characteristic in protected:
        # bumble creates the descriptor automatically, without restrictions.
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
    """Answer reads of and subscriptions to these characteristics with ATT error 0x08."""
    for service in services:
        for characteristic in _characteristics(service):
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
