"""The air between virtual Bluetooth LE devices and the computers that listen to them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

from bumble.device import Connection, Device, DeviceConfiguration
from bumble.hci import Address
from bumble.host import Host
from bumble.keys import KeyStore
from bumble.link import LocalLink
from bumble.pairing import PairingConfig, PairingDelegate

from biosensor_gateway.simulation.transceiver import Transceiver
from biosensor_gateway.simulation.world import World

MAX_MTU = 517
"""What BlueZ asks for; the largest attribute value (512 bytes) fits."""
_HOST_ADDRESS = "F0:00:00:00:00:{:02X}"
_ENCRYPTION_KEY_ONLY = PairingDelegate.KeyDistribution.DISTRIBUTE_ENCRYPTION_KEY


class Radio:
    """The air; devices and hosts on it live in one world's loop.

    Parameters
    ----------
    host_mtu
        The ATT MTU that hosts ask for; 23 leaves everybody with 20 bytes a packet.

    Attributes
    ----------
    air
        The medium that the transceivers share.
    on_switched_off
        Called in the world's loop when the hosts' Bluetooth is switched off.
    """

    def __init__(self, world: World, *, host_mtu: int = MAX_MTU) -> None:
        # bumble words its messages before it asks whether anybody wants them.
        logging.getLogger("bumble").setLevel(logging.WARNING)
        self.world = world
        self.host_mtu = host_mtu
        self.air = LocalLink()
        self.on_switched_off: list[Callable[[], None]] = []
        self._available = True
        self._hosts: dict[Device, Transceiver] = {}
        self._hosts_made = 0

    @property
    def available(self) -> bool:
        """Whether the hosts' Bluetooth is switched on; settable from any thread.

        Switched off, their connections are lost and their scans end for good; the
        devices stay on the air.
        """
        return self._available

    @available.setter
    def available(self, available: bool) -> None:
        self._available = available
        self.world.loop.call_soon_threadsafe(self._switch_hosts, available)

    async def host(self) -> Device:
        """Return a new, powered central, for a host stack; give it back with `release`."""
        self._hosts_made += 1
        transceiver = Transceiver(f"host {self._hosts_made}", self.air)
        address = _HOST_ADDRESS.format(self._hosts_made)
        device = await self.power_on(transceiver, transceiver.name, address)
        self._hosts[device] = transceiver
        transceiver.deaf = not self._available
        return device

    async def release(self, host: Device) -> None:
        """Switch a host off for good; its connections are lost."""
        await self.power_off(self._hosts.pop(host), host)

    async def power_on(
        self, transceiver: Transceiver, name: str, address: str, bonds: KeyStore | None = None
    ) -> Device:
        """Boot a Bluetooth stack on a transceiver."""
        config = DeviceConfiguration(name=name, address=Address(address))
        device = Device(config=config, host=Host(transceiver, transceiver))
        device.pairing_config_factory = _just_works
        device.keystore = bonds
        await device.power_on()
        return device

    async def power_off(self, transceiver: Transceiver, device: Device) -> None:
        """Take a stack off the air, with its connections."""
        transceiver.le_legacy_advertiser.stop()
        transceiver.lose_links()
        self.air.remove_controller(transceiver)
        # Connections that end with the flush, not before it, would set off advertising again.
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
    """Pair without a display or keys to press; addresses are what they seem to be."""
    delegate = PairingDelegate(
        PairingDelegate.IoCapability.NO_OUTPUT_NO_INPUT,
        _ENCRYPTION_KEY_ONLY,
        _ENCRYPTION_KEY_ONLY,
    )
    return PairingConfig(sc=True, mitm=False, bonding=True, delegate=delegate)
