"""A host that knows no device: plain bleak, and everything it heard."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import NamedTuple

from bleak import BleakClient, BleakScanner
from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.device import BLEDevice
from bleak.backends.scanner import AdvertisementData

from tests.rigs.polling import until

_SCAN_S = 20.0


class Heard(NamedTuple):
    """One notification or indication, and when it arrived on the LSL clock [s]."""

    data: bytes
    arrival: float


class GattHost:
    """A connected host."""

    def __init__(self, client: BleakClient) -> None:
        self.client = client
        # By characteristic, as it was subscribed to.
        self.heard: defaultdict[str, list[Heard]] = defaultdict(list)

    async def subscribe(self, *uuids: str) -> None:
        """Listen to characteristics from now on."""
        # On Linux a loop goes by the same clock as LSL does, in virtual time as well.
        now = asyncio.get_running_loop().time
        for uuid in uuids:
            log = self.heard[uuid]

            def hear(_: BleakGATTCharacteristic, data: bytearray, log: list[Heard] = log) -> None:
                log.append(Heard(bytes(data), now()))

            await self.client.start_notify(uuid, hear)

    async def ask(self, uuid: str, command: str) -> str:
        """Write a command in hexadecimal digits; return the indication that follows."""
        count = len(self.heard[uuid])
        await self.client.write_gatt_char(uuid, bytes.fromhex(command), response=True)
        await self.more(uuid, 1, count)
        return self.heard[uuid][count].data.hex()

    async def more(self, uuid: str, count: int, since: int | None = None) -> list[bytes]:
        """Wait for so many further values; return what came since."""
        since = len(self.heard[uuid]) if since is None else since
        await until(lambda: len(self.heard[uuid]) >= since + count)
        return [heard.data for heard in self.heard[uuid][since:]]

    def all(self, uuid: str) -> list[bytes]:
        """Return everything that came."""
        return [heard.data for heard in self.heard[uuid]]


@asynccontextmanager
async def connection(name: str) -> AsyncGenerator[GattHost]:
    """Find a device by its name and connect to it."""
    device, _ = await advertised(name)
    async with BleakClient(device) as client:
        yield GattHost(client)


async def advertised(name: str) -> tuple[BLEDevice, AdvertisementData]:
    """Wait until a device of this name is heard; return what it says."""
    async with asyncio.timeout(_SCAN_S), BleakScanner() as scanner:
        async for device, data in scanner.advertisement_data():
            if data.local_name == name:
                return device, data
    raise TimeoutError(name)
