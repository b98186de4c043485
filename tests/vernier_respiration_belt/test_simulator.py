"""The virtual belt: its firmware against the vectors, and on the air against plain bleak."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import AsyncGenerator, Generator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bleak import BleakClient, BleakScanner

from biosensor_gateway.devices.vernier_respiration_belt.simulator import SimulatedBelt, wire
from biosensor_gateway.devices.vernier_respiration_belt.simulator.wire import BeltFirmware
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World

COMMAND = "f4bf14a6-c7d5-4b6d-8aa8-df1a7c83adcb"
RESPONSE = "b41e6675-a329-40e0-aa01-44d2f444babe"
DEADLINE_S = 20.0
VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/vernier_gdxrb.json").read_text(encoding="utf-8")
)
CONVERSATION = [vector for vector in VECTORS if vector["name"].startswith("conv_")]
INIT = "1aa54a06490748084709460a450b440c430d420e41"
# Whatever the vendor's numbers are, the notes call these placeholders.
_PLACEHOLDERS = ("get_sensor_info", "get_device_info")


def test_the_firmware_answers_as_in_the_worked_conversation() -> None:
    firmware = BeltFirmware("GDX-RB", "0K2002Z5")
    answers: list[bytes] = []
    for vector in CONVERSATION:
        data = bytes.fromhex(vector["hex"])
        if "_cmd_" in vector["name"]:
            answers = firmware.hear(data)
        elif "_rsp_" in vector["name"]:
            (answer,) = answers
            if any(each in vector["name"] for each in _PLACEHOLDERS):
                assert answer[:6] == data[:6].replace(data[3:4], answer[3:4], 1)
                assert len(answer) == len(data)
            else:
                assert answer == data, vector["name"]
        else:
            assert firmware.pack(np.array([[11.5, np.nan]], np.float32)) == data


def test_fragments_make_one_command() -> None:
    firmware = BeltFirmware("GDX-RB", "0K2002Z5")
    packet = wire.seal(0x58, 0xFE, bytes.fromhex(INIT))
    assert firmware.hear(packet[:20]) == []
    (answer,) = firmware.hear(packet[20:])
    assert answer.hex() == "980700b71afe00"


def test_a_damaged_command_is_not_obeyed() -> None:
    firmware = BeltFirmware("GDX-RB", "0K2002Z5")
    packet = bytearray(wire.seal(0x58, 0xFE, bytes.fromhex(INIT)))
    packet[10] ^= 1
    assert firmware.hear(bytes(packet)) == []
    assert firmware.hear(wire.seal(0x58, 0xFD, b"\x10"))


@pytest.fixture
def radio(virtual_world: World) -> Generator[Radio]:
    air = Radio(virtual_world)
    with virtual_bluetooth(air):
        yield air


class Host:
    """A bare host, after the notes."""

    def __init__(self, client: BleakClient) -> None:
        self._client = client
        self._counter = 0xFF
        self._buffer = bytearray()
        self.packets: asyncio.Queue[bytes] = asyncio.Queue()

    def take(self, _sender: object, data: bytearray) -> None:
        self._buffer += data
        while len(self._buffer) > 1 and len(self._buffer) >= self._buffer[1]:
            length = self._buffer[1]
            self.packets.put_nowait(bytes(self._buffer[:length]))
            del self._buffer[:length]

    async def ask(self, body: str) -> bytes:
        self._counter = (self._counter - 1) % 256
        packet = wire.seal(0x58, self._counter, bytes.fromhex(body))
        for begin in range(0, len(packet), 20):
            await self._client.write_gatt_char(COMMAND, packet[begin : begin + 20], response=True)
        async with asyncio.timeout(DEADLINE_S):
            while (answer := await self.packets.get())[0] == 0x20:
                pass
        assert answer[5] == self._counter
        return answer[6:]

    async def start(self, period_us: int = 100_000) -> None:
        assert await self.ask(INIT) == b"\0"
        assert await self.ask("1bff00" + struct.pack("<Q", period_us).hex()) == b"\0"
        assert await self.ask("18ff0106000000" + "00" * 8) == b"\0"

    async def samples(self, count: int) -> np.ndarray[Any, np.dtype[np.float32]]:
        rows: list[Any] = []
        async with asyncio.timeout(DEADLINE_S):
            while len(rows) < count:
                packet = await self.packets.get()
                if packet[0] == 0x20:
                    assert wire.is_sealed(packet)
                    data = np.frombuffer(packet[9:], "<f4").reshape(packet[7], 2)
                    rows += list(data)
        return np.array(rows, np.float32)


@asynccontextmanager
async def _host() -> AsyncGenerator[Host]:
    device = await BleakScanner.find_device_by_filter(
        lambda _, seen: (seen.local_name or "").startswith("GDX-RB "), timeout=DEADLINE_S
    )
    assert device is not None
    async with BleakClient(device) as client:
        host = Host(client)
        await client.start_notify(RESPONSE, host.take)
        yield host


@pytest.mark.parametrize("max_mtu", [23, 158])
async def test_samples_are_the_truth(radio: Radio, max_mtu: int) -> None:
    with SimulatedBelt(radio.world, radio, seed=3, warm_up_s=1.0, max_mtu=max_mtu) as belt:
        async with _host() as host:
            await host.start(50_000)
            received = await host.samples(60)
        force, rate = belt.truth.samples("force"), belt.truth.samples("bpm")
        size = len(received)
        np.testing.assert_array_equal(received[:, 0], force.values[:size, 0].astype(np.float32))
        np.testing.assert_array_equal(received[:, 1], rate.values[:size, 0].astype(np.float32))
        np.testing.assert_allclose(np.diff(force.times), 0.05, atol=1e-9)
        assert np.isnan(received[0, 1])
        assert received[-1, 1] == pytest.approx(15, abs=1)


@pytest.mark.parametrize("kind", [FaultKind.DROP, FaultKind.RESTART])
async def test_a_lost_belt_comes_back_and_has_forgotten_its_modes(
    radio: Radio, kind: FaultKind
) -> None:
    with SimulatedBelt(radio.world, radio) as belt:
        async with _host() as host:
            await host.start()
            await host.samples(5)
            belt.apply(Fault(kind, 1.0))
        sent = len(belt.truth.samples("force").times)
        async with _host() as host:
            await host.ask("10")
            await asyncio.sleep(0.5)
            assert len(belt.truth.samples("force").times) == sent
            await host.start()
            assert len(await host.samples(5)) == 5
