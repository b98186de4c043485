"""A platform backend of bleak whose radio is virtual.

While `virtual_bluetooth` lasts, code that uses plain ``BleakScanner`` and
``BleakClient`` talks to virtual devices, and sees what it would see on Windows, macOS
or Linux: a local disconnect calls back as well as a lost link, requests fail when the
link goes, and so on.
"""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from contextlib import contextmanager
from functools import partial

from bleak.backends.adapter import BaseBleakAdapter
from bleak.backends.scanner import (
    AdvertisementData,
    AdvertisementDataCallback,
    BaseBleakScanner,
)
from bleak.exc import BleakError

from biosensor_gateway.simulation.advertising import Advertised
from biosensor_gateway.simulation.bleak_client import VirtualClient
from biosensor_gateway.simulation.bleak_pickers import standing_in
from biosensor_gateway.simulation.central import Central, Heard, Listener
from biosensor_gateway.simulation.crossing import in_world, tell
from biosensor_gateway.simulation.radio import Radio


@contextmanager
def virtual_bluetooth(radio: Radio) -> Generator[None]:
    """Have bleak, in every loop and thread of this process, use a virtual radio.

    Raises
    ------
    RuntimeError
        If this version of bleak picks its backends otherwise than is known here.
    """
    central = radio.world.await_(Central.on_the_air(radio))
    backends = partial(VirtualScanner, central), partial(VirtualClient, central), BaseBleakAdapter
    try:
        with standing_in(backends):
            yield
    finally:
        radio.world.await_(central.close())


class VirtualScanner(BaseBleakScanner):
    """A scan on a virtual adapter.

    As on every platform, what was heard of a device adds up: the first callback may
    lack what comes with the scan response, usually the name.

    Parameters
    ----------
    central
        The adapter.
    detection_callback, service_uuids, scanning_mode
        As ``BleakScanner`` hands them on.
    """

    def __init__(
        self,
        central: Central,
        detection_callback: AdvertisementDataCallback | None,
        service_uuids: list[str] | None,
        scanning_mode: str = "active",
        **_of_platforms: object,
    ) -> None:
        super().__init__(detection_callback, service_uuids)
        self._central = central
        self._passive = scanning_mode == "passive"
        self._listener: Listener | None = None
        self._known: dict[str, Advertised] = {}

    async def start(self) -> None:
        """Begin to scan."""
        if self._listener:
            raise BleakError("Scanner already started")
        self.seen_devices = {}
        self._known = {}
        loop = asyncio.get_running_loop()

        def listener(heard: Heard) -> None:
            tell(loop, self._on_heard, heard)

        await in_world(self._central.radio.world, self._central.listen(listener))
        self._listener = listener

    async def stop(self) -> None:
        """End the scan."""
        listener, self._listener = self._listener, None
        if listener:
            await in_world(self._central.radio.world, self._central.unlisten(listener))

    def _on_heard(self, heard: Heard) -> None:
        if self._passive and heard.is_response:
            return
        known = self._known.setdefault(heard.address, Advertised())
        known.hear(heard.data, heard.rssi_dbm)
        if not self.is_allowed_uuid(known.service_uuids):
            return
        data = AdvertisementData(
            local_name=known.name,
            manufacturer_data=dict(known.manufacturer_data),
            service_data={},
            service_uuids=list(known.service_uuids),
            tx_power=None,
            rssi=known.rssi_dbm,
            platform_data=(),
        )
        address = heard.address
        device = self.create_or_update_device(address, address, known.name, None, data)
        self.call_detection_callbacks(device, data)
