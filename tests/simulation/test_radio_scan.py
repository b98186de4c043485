"""What a plain BleakScanner hears on the virtual radio."""

from __future__ import annotations

import asyncio

import bleak
import bleak.backends.scanner
import pytest
from bleak import BleakClient, BleakScanner
from bleak.backends.device import BLEDevice
from bleak.backends.scanner import AdvertisementData
from bleak.exc import (
    BleakBluetoothNotAvailableError,
    BleakBluetoothNotAvailableReason,
    BleakDeviceNotFoundError,
    BleakError,
)

from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio import Radio
from tests.rigs.polling import until
from tests.rigs.probe import COMPANY, Probe

HEART_RATE = "0000180d-0000-1000-8000-00805f9b34fb"
POLAR = "0000feee-0000-1000-8000-00805f9b34fb"


async def test_everything_advertised_is_heard(probe: Probe) -> None:
    heard: list[tuple[BLEDevice, AdvertisementData]] = []
    async with BleakScanner(lambda device, data: heard.append((device, data))) as scanner:
        await until(lambda: any(data.local_name for _, data in heard))
    device, data = heard[-1]
    assert (device.address, device.name, data.local_name) == (probe.address, "Probe 1", "Probe 1")
    assert data.manufacturer_data == {COMPANY: b"\x01\x02\x03"}
    assert set(data.service_uuids) == {HEART_RATE, POLAR}
    assert data.rssi == -61
    assert scanner.discovered_devices == [device]


async def test_the_name_comes_with_the_scan_response(probe: Probe) -> None:
    names: list[str | None] = []
    async with BleakScanner(lambda _, data: names.append(data.local_name)):
        await until(lambda: len(names) >= 4)
    assert names[0] is None
    assert set(names[1:]) == {"Probe 1"}


async def test_a_passive_scan_hears_no_name(probe: Probe) -> None:
    names: list[str | None] = []
    scanner = BleakScanner(lambda _, data: names.append(data.local_name), None, "passive")
    async with scanner:
        await until(lambda: len(names) >= 3)
    assert set(names) == {None}


async def test_strength_and_manufacturer_data_follow_the_device(probe: Probe) -> None:
    latest: list[AdvertisementData] = []
    async with BleakScanner(lambda _, data: latest.append(data)):
        await until(lambda: latest)
        probe.radio.world.call(lambda: probe.peripheral.set_rssi(-90))
        probe.radio.world.call(lambda: probe.peripheral.set_manufacturer_data({COMPANY: b"new"}))
        await until(
            lambda: latest[-1].rssi == -90 and latest[-1].manufacturer_data == {COMPANY: b"new"}
        )


async def test_a_scan_for_a_service_hears_only_those_who_have_it(probe: Probe) -> None:
    other = Peripheral(probe.radio, "A0:9E:1A:00:00:02", "Other", service_uuids=["181a"])
    probe.radio.world.await_(other.power_on([]))
    heard: set[str] = set()
    everybody: set[str] = set()
    async with (
        BleakScanner(lambda device, _: heard.add(device.address), [HEART_RATE.upper()]),
        BleakScanner(lambda device, _: everybody.add(device.address)),
    ):
        await until(lambda: everybody == {probe.address, other.address})
        await until(lambda: heard)
    assert heard == {probe.address}


async def test_two_scans_at_once_end_one_by_one(probe: Probe) -> None:
    first: list[str] = []
    second: list[str] = []
    async with BleakScanner(lambda device, _: first.append(device.address)):
        async with BleakScanner(lambda device, _: second.append(device.address)):
            await until(lambda: first and second)
        ended_at = len(second)
        first.clear()
        await until(lambda: len(first) > 3)
    assert len(second) == ended_at


async def test_a_device_that_is_silent_is_not_heard(probe: Probe) -> None:
    probe.radio.world.call(lambda: probe.peripheral.set_advertising(False))
    assert await BleakScanner.find_device_by_name("Probe 1", timeout=0.4) is None
    probe.radio.world.call(lambda: probe.peripheral.set_advertising(True))
    assert await BleakScanner.find_device_by_name("Probe 1", timeout=20) is not None


async def test_a_device_that_is_connected_does_not_advertise(probe: Probe) -> None:
    device = await BleakScanner.find_device_by_name("Probe 1", timeout=20)
    assert device
    async with BleakClient(device):
        assert await BleakScanner.find_device_by_name("Probe 1", timeout=0.4) is None
    assert await BleakScanner.find_device_by_name("Probe 1", timeout=20) is not None


async def test_radio_off_refuses_to_scan_and_to_connect(probe: Probe) -> None:
    probe.radio.available = False
    for attempt in (BleakScanner().start(), BleakClient(probe.address).connect()):
        with pytest.raises(BleakBluetoothNotAvailableError) as caught:
            await attempt
        assert caught.value.reason is BleakBluetoothNotAvailableReason.POWERED_OFF
    probe.radio.available = True
    assert await BleakScanner.find_device_by_name("Probe 1", timeout=20) is not None


async def test_a_scan_does_not_survive_the_radio(probe: Probe) -> None:
    heard: list[str] = []
    async with BleakScanner(lambda device, _: heard.append(device.address)):
        await until(lambda: heard)
        probe.radio.available = False
        probe.radio.available = True
        probe.radio.world.call(lambda: None)
        await asyncio.sleep(0)
        heard.clear()
        again = await BleakScanner.find_device_by_name("Probe 1", timeout=20)
        assert again is not None
    assert not heard


async def test_an_absent_address_is_not_found(radio: Radio) -> None:
    with pytest.raises(BleakDeviceNotFoundError):
        await BleakClient("A0:9E:1A:00:00:99", timeout=0.3).connect()


async def test_a_device_that_left_after_the_scan_does_not_connect(probe: Probe) -> None:
    device = await BleakScanner.find_device_by_name("Probe 1", timeout=20)
    assert device
    probe.power_off()
    with pytest.raises(TimeoutError):
        await BleakClient(device, timeout=0.3).connect()
    probe.power_on()
    async with BleakClient(device, timeout=20) as client:
        assert client.is_connected


async def test_a_scanner_starts_once(probe: Probe) -> None:
    async with BleakScanner() as scanner:
        with pytest.raises(BleakError):
            await scanner.start()


async def test_bleak_gets_its_own_backends_back(radio: Radio) -> None:
    assert BleakScanner().backend_id == "virtual"
    inner = bleak.backends.scanner.get_platform_scanner_backend_type
    with virtual_bluetooth(radio):
        assert bleak.backends.scanner.get_platform_scanner_backend_type is not inner
    assert bleak.backends.scanner.get_platform_scanner_backend_type is inner


async def test_another_bleak_is_refused(radio: Radio, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(bleak, "get_platform_client_backend_type")
    with (
        pytest.raises(RuntimeError, match="get_platform_client_backend_type"),
        virtual_bluetooth(radio),
    ):
        pass


@pytest.mark.parametrize(
    ("name", "data"), [("N" * 30, b""), ("short", bytes(30))], ids=["name", "data"]
)
async def test_what_does_not_fit_into_an_advertisement_is_refused(
    radio: Radio, name: str, data: bytes
) -> None:
    with pytest.raises(ValueError, match="do not fit"):
        peripheral = Peripheral(radio, "A0:9E:1A:00:00:03", name, manufacturer_data={1: data})
        radio.world.await_(peripheral.power_on([]))
