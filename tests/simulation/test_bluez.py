"""bleak's own Linux backend against the fake BlueZ: that it works, fails and lies alike."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
import sys
import time
from collections.abc import AsyncGenerator, Iterator
from typing import IO, NamedTuple

import pytest
from bleak import BleakClient, BleakScanner
from bleak.args.bluez import BlueZScannerArgs
from bleak.backends import BleakBackend
from bleak.backends.device import BLEDevice
from bleak.backends.scanner import AdvertisementData
from bleak.exc import (
    BleakDeviceNotFoundError,
)

from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World
from tests.rigs.bluez import FakeBluez
from tests.rigs.polling import until
from tests.rigs.probe import COMPANY, FLOW, SERIAL, Probe

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(
        sys.platform != "linux" or not shutil.which("dbus-daemon"),
        reason="a Linux with dbus-daemon is needed",
    ),
]


@pytest.fixture
def probe() -> Iterator[Probe]:
    with World() as world:
        probe = Probe(Radio(world), "A0:9E:1A:00:00:01", "Probe 1", rssi_dbm=-61)
        probe.power_on()
        yield probe


@pytest.fixture
async def bluez(probe: Probe, monkeypatch: pytest.MonkeyPatch) -> AsyncGenerator[FakeBluez]:
    with FakeBluez(probe.radio) as bluez:
        for name, value in bluez.environment.items():
            monkeypatch.setenv(name, value)
        yield bluez
        bluez.kill_bus()
        await bleak_has_noticed()


class Rig(NamedTuple):
    """A process with virtual devices."""

    stdin: IO[str]
    stdout: IO[str]


@pytest.fixture
def rig() -> Iterator[Rig]:
    command = [sys.executable, "-m", "tests.rigs.bluez", "probe"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin
        assert process.stdout
        yield Rig(process.stdin, process.stdout)
    assert process.returncode == 0


async def bleak_has_noticed() -> None:
    """Wait until bleak's manager of this loop has closed its connection to a bus that ended."""
    await until(lambda: len(asyncio.all_tasks()) == 1)


async def found() -> BLEDevice:
    device = await BleakScanner.find_device_by_name("Probe 1", timeout=20)
    assert device
    return device


@pytest.mark.seam
async def test_everything_advertised_is_heard(bluez: FakeBluez, probe: Probe) -> None:
    heard: list[AdvertisementData] = []
    async with BleakScanner(lambda _, data: heard.append(data)) as scanner:
        assert scanner.backend_id is BleakBackend.BLUEZ_DBUS
        await until(lambda: any(data.local_name for data in heard))
    assert (heard[0].local_name, heard[-1].local_name) == (None, "Probe 1")
    assert heard[-1].manufacturer_data == {COMPANY: b"\x01\x02\x03"}
    assert heard[-1].rssi == -61
    assert "0000180d-0000-1000-8000-00805f9b34fb" in heard[-1].service_uuids


async def test_what_does_not_change_is_told_seldom_unless_asked_for(
    bluez: FakeBluez, probe: Probe
) -> None:
    changes: list[str] = []
    every: list[str] = []
    begin_s = time.monotonic()
    async with BleakScanner(lambda device, _: changes.append(device.address)):
        # Advertisement and scan response, and the strength again and again.
        await until(lambda: len(changes) >= 4)
        assert len(changes) - 3 <= time.monotonic() - begin_s
    filters: BlueZScannerArgs = {"filters": {"DuplicateData": True}}
    async with BleakScanner(lambda device, _: every.append(device.address), bluez=filters):
        await until(lambda: len(every) > 10)


async def test_a_read_is_also_notified(bluez: FakeBluez, probe: Probe) -> None:
    got: list[bytes] = []
    async with BleakClient(await found()) as client:
        await client.start_notify(FLOW, lambda _, data: got.append(bytes(data)))
        assert await client.read_gatt_char(FLOW) == b"still"
        await until(lambda: got == [b"still"])


async def test_an_absent_address(bluez: FakeBluez) -> None:
    with pytest.raises(BleakDeviceNotFoundError):
        await BleakClient("A0:9E:1A:00:00:99", timeout=0.3).connect()


async def test_devices_in_a_process_of_their_own(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in json.loads(rig.stdout.readline())["environment"].items():
        monkeypatch.setenv(name, value)
    async with BleakClient(await found()) as client:
        assert await client.read_gatt_char(SERIAL) == b"0815"
    rig.stdin.write("connect_error Connection refused\nforget nobody\nkill_bus\n")
    rig.stdin.flush()
    assert rig.stdout.readline() == "ok\n"
    assert "forget nobody" in rig.stdout.readline()
    assert rig.stdout.readline() == "ok\n"
    await bleak_has_noticed()
