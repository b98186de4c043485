"""The virtual headbands on the virtual radio, heard through plain bleak."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np
import pytest

from biosensor_gateway.devices.muse.simulator import SimulatedAthena
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.gatt_host import GattHost, connection
from tests.rigs.polling import until

if TYPE_CHECKING:
    from tests.muse.conftest import Make

pytestmark = ON_BUMBLE

CONTROL = "273e0001-4c4d-454d-96be-f03bac821358"
DATA_1 = "273e0013-4c4d-454d-96be-f03bac821358"
ATHENA = pytest.mark.parametrize("kind", [SimulatedAthena], ids=["athena"])


async def tell(host: GattHost, command: str) -> None:
    data = bytes([len(command) + 1]) + command.encode() + b"\n"
    await host.client.write_gatt_char(CONTROL, data, response=False)


@ATHENA
async def test_frames_of_an_athena_are_as_long_and_as_old_as_recorded_ones(headband: Make) -> None:
    headband()
    async with connection("MuseS-FA20") as host:
        await host.subscribe(CONTROL)
        await host.subscribe(DATA_1)
        await tell(host, "p1041")
        await tell(host, "dc001")
        await until(lambda: len(host.all(DATA_1)) >= 40)
        frames = host.all(DATA_1)[:40]
    assert all(frame[0] == len(frame) for frame in frames)
    assert {150 < len(frame) <= 240 for frame in frames} == {True}
    assert [struct.unpack_from("<H", frame, 1)[0] for frame in frames] == list(range(40))
    clocks_ms = np.array([int.from_bytes(frame[3:9], "little") for frame in frames])
    steps = np.diff(clocks_ms)
    assert clocks_ms[0] > 1.7e12
    assert steps.max() <= 130
    # As recorded, where 3 to 15 % of them turn back by up to 60 ms; here none does.
    assert steps.min() >= -60
