"""The virtual headbands on the virtual radio, heard through plain bleak."""

from __future__ import annotations

import json
import struct
from typing import TYPE_CHECKING

import numpy as np
import pytest

from biosensor_gateway.devices.muse.simulator import SimulatedAthena, SimulatedMuse
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.gatt_host import GattHost, advertised, connection
from tests.rigs.polling import until

if TYPE_CHECKING:
    from tests.muse.conftest import Make

pytestmark = ON_BUMBLE

NAMES = {SimulatedMuse: "Muse-3A1F", SimulatedAthena: "MuseS-FA20"}
CONTROL = "273e0001-4c4d-454d-96be-f03bac821358"
TP9 = "273e0003-4c4d-454d-96be-f03bac821358"
RED = "273e0011-4c4d-454d-96be-f03bac821358"
ACC = "273e000a-4c4d-454d-96be-f03bac821358"
DATA_1 = "273e0013-4c4d-454d-96be-f03bac821358"
CLASSIC = pytest.mark.parametrize("kind", [SimulatedMuse], ids=["classic"])
ATHENA = pytest.mark.parametrize("kind", [SimulatedAthena], ids=["athena"])


async def tell(host: GattHost, command: str) -> None:
    data = bytes([len(command) + 1]) + command.encode() + b"\n"
    await host.client.write_gatt_char(CONTROL, data, response=False)


def answers(host: GattHost) -> list[dict[str, object]]:
    """Return the answers so far: pieces of 20 bytes, counted."""
    pieces = host.all(CONTROL)
    assert {len(each) for each in pieces} <= {20}
    text = "".join(each[1 : 1 + each[0]].decode() for each in pieces)
    return [json.loads(f"{{{each}") for each in text.split("{")[1:] if each.endswith("}")]


async def test_it_is_advertised_with_its_service(headband: Make) -> None:
    device = headband()
    _, data = await advertised(NAMES[type(device)])
    assert {uuid[4:8] for uuid in data.service_uuids} == {"fe8d"}
    assert device.settings == {"device": NAMES[type(device)][-4:]}


async def test_it_answers_every_command(headband: Make) -> None:
    device = headband()
    async with connection(NAMES[type(device)]) as host:
        await host.subscribe(CONTROL)
        for command in ("v1", "s", "h", "p21", "k", "nonsense"):
            await tell(host, command)
        await until(lambda: len(answers(host)) == 6)
        assert [each["rc"] for each in answers(host)] == [0, 0, 0, 0, 0, 1]
        version, status = answers(host)[:2]
        assert {"ap", "fw", "hw", "pv"} <= version.keys()
        assert status["bp"] == 87
        assert str(status["hn"]) == NAMES[type(device)]


@CLASSIC
async def test_packets_of_a_classic_are_numbered_and_the_truth(headband: Make) -> None:
    device = headband()
    async with connection("Muse-3A1F") as host:
        for uuid in (CONTROL, TP9, RED, ACC):
            await host.subscribe(uuid)
        await tell(host, "p51")
        await tell(host, "d")
        await until(lambda: min(len(host.all(uuid)) for uuid in (TP9, RED, ACC)) >= 5)
        eeg, red, acc = (host.all(uuid)[:5] for uuid in (TP9, RED, ACC))
    for packets in (eeg, red, acc):
        assert {len(each) for each in packets} == {20}
        assert [struct.unpack_from(">H", each)[0] for each in packets] == [0, 1, 2, 3, 4]
    digits = "".join(each[2:].hex() for each in eeg)
    counts = [int(digits[at : at + 3], 16) for at in range(0, len(digits), 3)]
    microvolts = (np.array(counts) - 2048) * 0.48828125
    np.testing.assert_allclose(device.truth.samples("eeg").values[:60, 0], microvolts)
    values = np.frombuffer(b"".join(each[2:] for each in acc), ">i2").reshape(-1, 3) / 16384
    np.testing.assert_allclose(device.truth.samples("acc").values[:15], values)


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


async def test_it_is_silent_after_it_was_told_to_be(headband: Make) -> None:
    device = headband()
    is_athena = isinstance(device, SimulatedAthena)
    uuid = DATA_1 if is_athena else TP9
    async with connection(NAMES[type(device)]) as host:
        await host.subscribe(CONTROL)
        await host.subscribe(uuid)
        await tell(host, "dc001" if is_athena else "d")
        await until(lambda: len(host.all(uuid)) >= 3)
        await tell(host, "h")
        await until(lambda: len(answers(host)) == 2)
        count = len(host.all(uuid))
        await tell(host, "s")
        await until(lambda: len(answers(host)) == 3)
        assert len(host.all(uuid)) == count


async def test_who_hears_nothing_gives_up(headband: Make) -> None:
    device = headband(patience_s=5.0)
    async with connection(NAMES[type(device)]) as host:
        await host.subscribe(CONTROL)
        await tell(host, "dc001" if isinstance(device, SimulatedAthena) else "d")
        await until(lambda: not host.client.is_connected)
