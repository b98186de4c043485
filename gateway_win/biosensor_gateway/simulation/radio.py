"""The radio medium between virtual Bluetooth LE devices and computers, and advertisements.

Layout of advertisements: Supplement to the Bluetooth Core Specification, Part A.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from bleak.uuids import normalize_uuid_str
from bumble import hci, ll
from bumble.controller import Connection as AirConnection
from bumble.controller import Controller
from bumble.core import UUID, AdvertisingData, PhysicalTransport
from bumble.device import Connection, Device, DeviceConfiguration
from bumble.hci import Address
from bumble.host import Host
from bumble.keys import KeyStore
from bumble.link import LocalLink
from bumble.pairing import PairingConfig, PairingDelegate

from biosensor_gateway.simulation.world import World

_EXTENDED = hci.LeFeatureMask.LE_EXTENDED_ADVERTISING | hci.LeFeatureMask.LE_PERIODIC_ADVERTISING
_ACTIVE_SCAN = 0x01
_REPORT = hci.HCI_LE_Advertising_Report_Event
_MAX_BYTES = 31
_LE_ONLY_GENERAL_DISCOVERABLE = 0x06
_Kind = AdvertisingData.Type


@dataclass
class _Scannable(ll.AdvInd):
    """An advertisement with signal strength and scan response."""

    scan_response: bytes
    rssi_dbm: int


class Transceiver(Controller):
    """A Bluetooth controller on the radio.

    bumble's own controller repeats the advertisement as scan response, receives everything at -50
    dBm, cannot cancel a connection attempt, and reports a connection to a central even if the
    peripheral did not accept it.

    Parameters
    ----------
    air
        Radio medium shared with others.
    """

    # Legacy advertising has a separate scan response, which the sensors use.
    le_features = Controller.le_features & ~_EXTENDED
    # One fragment per notification, so that bursts of a device do not wait in its host.
    le_acl_data_packet_length = 0xFFFF
    total_num_le_acl_data_packets = 0xFF

    def __init__(self, name: str, air: LocalLink) -> None:
        # bumble does not annotate a parameter.
        super().__init__(name, link=air)  # pyright: ignore[reportUnknownMemberType]
        self.air = air
        self.rssi_dbm = -58  # Signal strength as received by others.
        self.audible = True  # Whether others receive its advertisements and can connect.
        self.deaf = False  # Whether it does not receive advertisements.
        self._stalled = False
        self._held: list[tuple[hci.Address, PhysicalTransport, bytes]] = []

    @property
    def stalled(self) -> bool:
        """Whether received data are held; they are delivered in order when this ends."""
        return self._stalled

    @stalled.setter
    def stalled(self, stalled: bool) -> None:
        self._stalled = stalled
        if not stalled:
            held, self._held = self._held, []
            for sender, transport, data in held:
                self.on_link_acl_data(sender, transport, data)

    def lose_links(self) -> None:
        """Lose all connections on both sides by supervision timeout."""
        reason = hci.HCI_ErrorCode.CONNECTION_TIMEOUT_ERROR
        for connection in list(self.le_connections.values()):
            peer = self.air.find_le_controller(connection.peer_address)
            self.on_le_disconnected(connection, reason)
            if peer and (other := peer.le_connections.get(connection.self_address)):
                peer.on_le_disconnected(other, reason)

    def on_le_disconnected(self, connection: AirConnection, reason: int) -> None:
        """Discard held data with the connection."""
        self._held.clear()
        super().on_le_disconnected(connection, reason)

    def send_advertising_pdu(self, packet: ll.AdvertisingPdu) -> None:
        """Add signal strength and scan response to an advertisement, or drop it."""
        if isinstance(packet, ll.AdvInd):
            if not self.audible:
                return
            response = self.le_legacy_advertiser.scan_response_data
            packet = _Scannable(
                packet.advertiser_address, packet.data, bytes(response), self.rssi_dbm
            )
        super().send_advertising_pdu(packet)

    def on_advertising_pdu(self, pdu: ll.AdvInd | ll.AdvExtInd) -> None:
        """Report an advertisement and, in an active scan, its scan response."""
        if self.deaf or not isinstance(pdu, _Scannable):
            return
        if self.le_scan_enable:
            self._report(_REPORT.EventType.ADV_IND, pdu, pdu.data)
            if self.le_scan_type == _ACTIVE_SCAN:
                self._report(_REPORT.EventType.SCAN_RSP, pdu, pdu.scan_response)
        pending = self.pending_le_connection
        if pending and pending.peer_address == pdu.advertiser_address:
            self.create_le_connection(pdu.advertiser_address)

    def on_le_connect_ind(self, packet: ll.ConnectInd) -> None:
        """Accept a connection, or let the central detect that it was not accepted."""
        if packet.advertiser_address != self.random_address:
            return
        if self.audible and self.le_legacy_advertiser.enabled:
            super().on_le_connect_ind(packet)
            return
        reason = hci.HCI_ErrorCode.CONNECTION_FAILED_TO_BE_ESTABLISHED_ERROR
        self.air.send_ll_control_pdu(
            packet.advertiser_address, packet.initiator_address, ll.TerminateInd(reason)
        )

    def on_ll_control_pdu(self, sender_address: hci.Address, packet: ll.ControlPdu) -> None:
        """Ignore packets that arrive after the end of their connection."""
        if sender_address in self.le_connections:
            super().on_ll_control_pdu(sender_address, packet)

    def on_link_acl_data(
        self, sender_address: hci.Address, transport: PhysicalTransport, data: bytes
    ) -> None:
        """Process data of a connection, or hold them while stalled."""
        if sender_address not in self.le_connections:
            return
        if self._stalled:
            self._held.append((sender_address, transport, data))
        else:
            super().on_link_acl_data(sender_address, transport, data)

    def on_hci_le_create_connection_cancel_command(
        self, _command: hci.HCI_SyncCommand[hci.HCI_StatusReturnParameters]
    ) -> hci.HCI_StatusReturnParameters:
        """Cancel a connection attempt (Core 5.4 Vol 4 Part E, 7.8.13)."""
        if pending := self.pending_le_connection:
            self.pending_le_connection = None
            self.send_hci_packet(
                hci.HCI_LE_Connection_Complete_Event(
                    status=hci.HCI_ErrorCode.UNKNOWN_CONNECTION_IDENTIFIER_ERROR,
                    connection_handle=0,
                    role=hci.Role.CENTRAL,
                    peer_address_type=pending.peer_address.address_type,
                    peer_address=pending.peer_address,
                    connection_interval=0,
                    peripheral_latency=0,
                    supervision_timeout=0,
                    central_clock_accuracy=0,
                )
            )
        return hci.HCI_StatusReturnParameters(hci.HCI_ErrorCode.SUCCESS)

    def _report(self, kind: _REPORT.EventType, pdu: _Scannable, data: bytes) -> None:
        report = _REPORT.Report(
            event_type=kind,
            address_type=pdu.advertiser_address.address_type,
            address=pdu.advertiser_address,
            data=data,
            rssi=pdu.rssi_dbm,
        )
        self.send_hci_packet(_REPORT([report]))


MAX_MTU = 517
"""MTU requested by BlueZ, which fits the largest attribute value (512 bytes)."""
_HOST_ADDRESS = "F0:00:00:00:00:{:02X}"
_ENCRYPTION_KEY_ONLY = PairingDelegate.KeyDistribution.DISTRIBUTE_ENCRYPTION_KEY


class Radio:
    """The radio medium; its devices and hosts run in one world's event loop.

    Parameters
    ----------
    host_mtu
        ATT MTU requested by hosts; 23 leaves 20 bytes per packet.
    """

    def __init__(self, world: World, *, host_mtu: int = MAX_MTU) -> None:
        # bumble formats its log messages before it checks their level.
        logging.getLogger("bumble").setLevel(logging.WARNING)
        self.world = world
        self.host_mtu = host_mtu
        self.air = LocalLink()  # Medium shared by the transceivers.
        # Called in the world's event loop when the hosts' Bluetooth is switched off.
        self.on_switched_off: list[Callable[[], None]] = []
        self._available = True
        self._hosts: dict[Device, Transceiver] = {}
        self._hosts_made = 0

    @property
    def available(self) -> bool:
        """Whether the hosts' Bluetooth is switched on; settable from any thread.

        When switched off, their connections are lost and their scans end; the devices stay on.
        """
        return self._available

    @available.setter
    def available(self, available: bool) -> None:
        self._available = available
        self.world.loop.call_soon_threadsafe(self._switch_hosts, available)

    async def host(self) -> Device:
        """Return a new central that is on, for a host stack; return it with `release`."""
        self._hosts_made += 1
        transceiver = Transceiver(f"host {self._hosts_made}", self.air)
        address = _HOST_ADDRESS.format(self._hosts_made)
        device = await self.power_on(transceiver, transceiver.name, address)
        self._hosts[device] = transceiver
        transceiver.deaf = not self._available
        return device

    async def release(self, host: Device) -> None:
        """Switch a host off permanently; its connections are lost."""
        await self.power_off(self._hosts.pop(host), host)

    async def power_on(
        self, transceiver: Transceiver, name: str, address: str, bonds: KeyStore | None = None
    ) -> Device:
        """Start a Bluetooth stack on a transceiver."""
        config = DeviceConfiguration(name=name, address=Address(address))
        device = Device(config=config, host=Host(transceiver, transceiver))
        device.pairing_config_factory = _just_works
        device.keystore = bonds
        await device.power_on()
        return device

    async def power_off(self, transceiver: Transceiver, device: Device) -> None:
        """Switch off a stack with its connections."""
        transceiver.le_legacy_advertiser.stop()
        transceiver.lose_links()
        self.air.remove_controller(transceiver)
        # Connections that end during the flush instead of before it would restart advertising.
        await asyncio.sleep(0)
        await device.power_off()

    def _switch_hosts(self, on: bool) -> None:
        for transceiver in self._hosts.values():
            transceiver.deaf = not on
            if not on:
                transceiver.lose_links()
        if not on:
            for callback in list(self.on_switched_off):
                callback()


def _just_works(_connection: Connection) -> PairingConfig:
    """Return a pairing configuration without display and keys, with public addresses."""
    delegate = PairingDelegate(
        PairingDelegate.IoCapability.NO_OUTPUT_NO_INPUT,
        _ENCRYPTION_KEY_ONLY,
        _ENCRYPTION_KEY_ONLY,
    )
    return PairingConfig(sc=True, mitm=False, bonding=True, delegate=delegate)


def pack_advertisement(uuids: Sequence[UUID], manufacturer_data: Mapping[int, bytes]) -> bytes:
    """Return flags, service UUIDs and manufacturer data.

    Raises
    ------
    ValueError
        If they are longer than a legacy advertisement, 31 bytes.
    """
    structures: list[tuple[int, bytes]] = [(_Kind.FLAGS, bytes([_LE_ONLY_GENERAL_DISCOVERABLE]))]
    for kind, size in (
        (_Kind.COMPLETE_LIST_OF_16_BIT_SERVICE_CLASS_UUIDS, 2),
        (_Kind.COMPLETE_LIST_OF_128_BIT_SERVICE_CLASS_UUIDS, 16),
    ):
        if listed := b"".join(bytes(uuid) for uuid in uuids if len(bytes(uuid)) == size):
            structures.append((kind, listed))
    for company, data in manufacturer_data.items():
        structures.append((_Kind.MANUFACTURER_SPECIFIC_DATA, company.to_bytes(2, "little") + data))
    return _packed(structures)


def pack_name(name: str) -> bytes:
    """Return the complete local name, for a scan response.

    Raises
    ------
    ValueError
        If it is longer than 29 bytes.
    """
    return _packed([(_Kind.COMPLETE_LOCAL_NAME, name.encode())])


@dataclass
class Advertised:
    """The combined contents of a device's advertisement and scan response."""

    rssi_dbm: int = -127
    name: str | None = None
    service_uuids: list[str] = field(default_factory=list[str])
    manufacturer_data: dict[int, bytes] = field(default_factory=dict[int, bytes])

    def hear(self, data: bytes, rssi_dbm: int) -> None:
        """Add an advertisement or a scan response."""
        self.rssi_dbm = rssi_dbm
        for kind, content in AdvertisingData.from_bytes(data).ad_structures:
            if kind == _Kind.COMPLETE_LOCAL_NAME:
                self.name = content.decode()
            elif kind == _Kind.MANUFACTURER_SPECIFIC_DATA:
                self.manufacturer_data[int.from_bytes(content[:2], "little")] = content[2:]
            elif kind == _Kind.COMPLETE_LIST_OF_16_BIT_SERVICE_CLASS_UUIDS:
                self._list(content, 2)
            elif kind == _Kind.COMPLETE_LIST_OF_128_BIT_SERVICE_CLASS_UUIDS:
                self._list(content, 16)

    def _list(self, content: bytes, size: int) -> None:
        for start in range(0, len(content), size):
            uuid = uuid_string(UUID.from_bytes(content[start : start + size]))
            if uuid not in self.service_uuids:
                self.service_uuids.append(uuid)


def uuid_string(uuid: UUID) -> str:
    """Return a UUID in the form of bleak and BlueZ: 128 bits, in lower case."""
    return normalize_uuid_str(uuid.to_hex_str("-"))


def _packed(structures: Sequence[tuple[int, bytes]]) -> bytes:
    packed = b"".join(bytes([len(data) + 1, kind]) + data for kind, data in structures)
    if len(packed) > _MAX_BYTES:
        raise ValueError(f"{len(packed)} bytes do not fit into an advertisement")
    return packed
