"""The virtual sensor on the virtual radio, heard through plain bleak."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.gatt_host import GattHost, connection
from tests.rigs.polling import until

if TYPE_CHECKING:
    from tests.movesense.conftest import MakeSensor

pytestmark = ON_BUMBLE

NAME = "Movesense 174630000192"
COMMAND = "34800001-7185-4d5d-b431-630e7050e8f0"
DATA = "34800002-7185-4d5d-b431-630e7050e8f0"


async def tell(host: GattHost, *command: bytes) -> None:
    await host.client.write_gatt_char(COMMAND, b"".join(command), response=True)


async def packets(host: GattHost, reference: int, count: int, *, part: int = 2) -> list[bytes]:
    """Wait for so many notifications of a subscription."""
    head = bytes([part, reference])

    def found() -> list[bytes]:
        return [each for each in host.all(DATA) if each.startswith(head)]

    await until(lambda: len(found()) >= count)
    return found()[:count]


async def test_its_packets_are_as_long_as_those_of_a_real_one(sensor: MakeSensor) -> None:
    sensor()
    async with connection(NAME) as host:
        await host.subscribe(DATA)
        await tell(host, b"\x01\x64/Meas/ECG/200")
        await tell(host, b"\x01\x65/Meas/IMU9/52\0")
        await tell(host, b"\x01\x66/Meas/HR")
        await tell(host, b"\x01\x67/Meas/Temp")
        lengths = [len((await packets(host, ref, 2))[1]) - 2 for ref in (100, 101, 102, 103)]
        assert lengths == [68, 148, 6, 8]
        answers = [each for each in host.all(DATA) if each[0] == 1]
        assert answers == [bytes([1, ref]) + struct.pack("<H", 200) for ref in range(100, 104)]
