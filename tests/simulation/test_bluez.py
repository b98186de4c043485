"""bleak's own Linux backend against the fake BlueZ: that it works, fails and lies alike."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
import sys
import time
from collections.abc import AsyncGenerator, Iterator
from contextlib import suppress
from typing import IO, Any, NamedTuple

import pytest
from bleak import BleakClient, BleakScanner
from bleak.args.bluez import BlueZScannerArgs
from bleak.backends import BleakBackend
from bleak.backends.device import BLEDevice
from bleak.backends.scanner import AdvertisementData
from bleak.exc import (
    BleakBluetoothNotAvailableError,
    BleakBluetoothNotAvailableReason,
    BleakDBusError,
    BleakDeviceNotFoundError,
    BleakError,
    BleakGATTProtocolError,
)

from biosensor_gateway.simulation.radio import Radio, Transceiver
from biosensor_gateway.simulation.world import World
from tests.rigs.bluez import FakeBluez
from tests.rigs.polling import until
from tests.rigs.probe import COMPANY, EVENT, FLOW, NOTE, REFUSAL, SECRET, SERIAL, Probe

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


@pytest.mark.seam
async def test_gatt(bluez: FakeBluez, probe: Probe) -> None:
    got: list[bytes] = []
    gone: list[BleakClient] = []
    async with BleakClient(await found(), gone.append) as client:
        assert await client.read_gatt_char(SERIAL) == b"0815"
        await client.write_gatt_char(NOTE, b"one", response=True)
        await client.write_gatt_char(NOTE, b"two", response=False)
        await until(lambda: probe.notes == [b"one", b"two"])
        for characteristic in (FLOW, EVENT):
            await client.start_notify(characteristic, lambda _, data: got.append(bytes(data)))
        sent = [count.to_bytes(2, "big") for count in range(500)]
        assert all(probe.notify(probe.flow, *sent))
        assert all(probe.notify(probe.event, b"event"))
        await until(lambda: len(got) == 501)
        assert got == [*sent, b"event"]
        await client.stop_notify(FLOW)
        await until(lambda: not probe.peripheral.subscribed(probe.flow))
        await client.disconnect()
    assert gone == [client]


@pytest.mark.parametrize("code", [0x06, 0x08, 0x0D, 0x0E, 0x80, 0xFD])
async def test_att_errors_arrive_with_their_codes(
    bluez: FakeBluez, probe: Probe, code: int
) -> None:
    async with BleakClient(await found()) as client:
        with pytest.raises(BleakGATTProtocolError) as caught:
            await client.write_gatt_char(REFUSAL, bytes([code]), response=True)
    assert caught.value.code == code


async def test_a_read_is_also_notified(bluez: FakeBluez, probe: Probe) -> None:
    got: list[bytes] = []
    async with BleakClient(await found()) as client:
        await client.start_notify(FLOW, lambda _, data: got.append(bytes(data)))
        assert await client.read_gatt_char(FLOW) == b"still"
        await until(lambda: got == [b"still"])


async def test_a_demand_to_pair_is_swallowed(bluez: FakeBluez, probe: Probe) -> None:
    probe.peripheral.demand_pairing = True
    async with BleakClient(await found()) as client:
        with pytest.raises(BleakGATTProtocolError) as caught:
            await client.write_gatt_char(SECRET, b"new", response=True)
        assert caught.value.code == 0x0E
        await client.pair()
        await client.write_gatt_char(SECRET, b"new", response=True)
        assert await client.read_gatt_char(SECRET) == b"new"


async def test_drops_and_returns(bluez: FakeBluez, probe: Probe) -> None:
    for cycle in range(3):
        got: list[bytes] = []
        gone = asyncio.Event()
        client = BleakClient(await found(), lambda _, gone=gone: gone.set())
        await client.connect()
        await client.start_notify(FLOW, lambda _, data, got=got: got.append(bytes(data)))
        assert probe.notify(probe.flow, bytes([cycle])) == [True]
        await until(lambda got=got: got)
        probe.drop()
        await gone.wait()
        assert not client.is_connected
        with pytest.raises(BleakError):
            _ = client.services
        await client.disconnect()
        probe.restore()


async def test_a_pending_request_fails_with_the_link(
    bluez: FakeBluez, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    held: list[bytes] = []
    take = Transceiver.on_link_acl_data

    def noted(self: Transceiver, sender: Any, transport: Any, data: bytes) -> None:
        take(self, sender, transport, data)
        if self.stalled:
            held.append(data)

    monkeypatch.setattr(Transceiver, "on_link_acl_data", noted)
    client = BleakClient(await found())
    await client.connect()
    probe.set_stalled(True)
    request = asyncio.create_task(client.read_gatt_char(SERIAL))
    await until(lambda: held)
    probe.drop()
    with pytest.raises(BleakGATTProtocolError) as caught:
        await request
    assert caught.value.code == 0x0E
    await client.disconnect()


async def test_connecting_fails_in_bluezs_words(bluez: FakeBluez, probe: Probe) -> None:
    device = await found()
    bluez.connect_error = "Connection refused"
    with pytest.raises(BleakDBusError, match="Connection refused") as caught:
        await BleakClient(device).connect()
    assert caught.value.dbus_error == "org.bluez.Error.Failed"
    bluez.connect_error = ""
    async with BleakClient(device) as client:
        assert client.is_connected


async def test_connecting_takes_too_long(bluez: FakeBluez, probe: Probe) -> None:
    device = await found()
    bluez.connect_delay_s = 60.0
    with pytest.raises(TimeoutError):
        await BleakClient(device, timeout=0.3).connect()
    bluez.connect_delay_s = 0.0
    async with BleakClient(device) as client:
        assert client.is_connected


async def test_an_adapter_that_is_off(bluez: FakeBluez, probe: Probe) -> None:
    gone = asyncio.Event()
    client = BleakClient(await found(), lambda _: gone.set())
    await client.connect()
    bluez.set_powered(False)
    await gone.wait()
    await client.disconnect()
    with pytest.raises(BleakBluetoothNotAvailableError) as caught:
        await BleakScanner().start()
    assert caught.value.reason is BleakBluetoothNotAvailableReason.POWERED_OFF
    bluez.set_powered(True)
    async with asyncio.timeout(20):
        while True:
            with suppress(BleakBluetoothNotAvailableError):
                await found()
                break
            await asyncio.sleep(0.01)


@pytest.mark.parametrize("at_once", [True, False])
async def test_an_object_that_is_removed_after_the_scan(
    bluez: FakeBluez, probe: Probe, at_once: bool
) -> None:
    bluez.forgets_after_scan = at_once
    device = await found()
    if not at_once:
        bluez.forget(probe.address)
    with pytest.raises(BleakError, match="not found"):
        await BleakClient(device).connect()
    bluez.forgets_after_scan = False
    async with BleakClient(await found()) as client:
        assert client.is_connected


async def test_an_absent_address(bluez: FakeBluez) -> None:
    with pytest.raises(BleakDeviceNotFoundError):
        await BleakClient("A0:9E:1A:00:00:99", timeout=0.3).connect()


async def test_a_daemon_that_dies_says_nothing(bluez: FakeBluez, probe: Probe) -> None:
    gone: list[BleakClient] = []
    client = BleakClient(await found(), gone.append)
    await client.connect()
    bluez.die()
    for attempt in (client.read_gatt_char(SERIAL), client.write_gatt_char(NOTE, b"1")):
        with pytest.raises(BleakDBusError):
            await attempt
    assert client.is_connected
    assert not gone
    with pytest.raises(BleakDBusError):
        await client.disconnect()


async def test_a_bus_that_dies_ends_the_link(bluez: FakeBluez, probe: Probe) -> None:
    gone = asyncio.Event()
    client = BleakClient(await found(), lambda _: gone.set())
    await client.connect()
    bluez.kill_bus()
    await gone.wait()
    assert not client.is_connected
    await client.disconnect()


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
