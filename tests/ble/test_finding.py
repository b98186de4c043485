"""Finding a Bluetooth LE device: which one it is, and the scan that all share."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from bleak import BleakScanner

from biosensor_common.errors import ProtocolReason
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports import ble_choice, ble_scanner
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_scanner import advertisements, scan
from tests.ble.conftest import absence, heard
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.polling import until
from tests.rigs.probe import Probe
from tests.rigs.probe_link import DEADLINE_S, choice, refusal, switched_on


async def hang(*_: Any) -> None:
    """Like a call whose service has died."""
    await asyncio.Event().wait()


@pytest.mark.usefixtures("hurry")
async def test_an_absent_device_is_absent_with_advice(probe: Probe) -> None:
    error = await absence(BleLink(choice("2")))
    assert str(error) == "Probe 2 is not in range; press its button"


@pytest.mark.parametrize("device", ["2", "probe 2", "a0-9e-1a-00-00-02", "A0:9E:1A:00:00:02"])
async def test_a_device_is_chosen_by_id_name_or_address(
    device: str, radio: Radio, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ble_choice, "OTHERS_S", 0.5)
    other = switched_on(radio, 2)
    link = BleLink(choice(device))
    assert (await link.open()).address == other.address
    await link.close()


@pytest.mark.usefixtures("hurry")
async def test_several_devices_are_refused_by_name(radio: Radio, probe: Probe) -> None:
    async with heard(probe, switched_on(radio, 2)):
        error = await refusal(BleLink(choice()).open())
    assert error.reason is ProtocolReason.REFUSED
    assert "(1, 2)" in str(error)
    assert "`device`" in str(error)


@pytest.mark.usefixtures("hurry")
async def test_the_only_device_is_kept_to(radio: Radio, probe: Probe) -> None:
    chosen = choice()
    first = BleLink(chosen)
    assert (await first.open()).address == probe.address
    switched_on(radio, 2)
    probe.drop()
    await first.close()
    error = await absence(BleLink(chosen))
    assert "Probe 1" in str(error)
    probe.restore()
    again = BleLink(chosen)
    assert (await again.open()).address == probe.address
    await again.close()


async def test_one_scan_serves_everybody(
    radio: Radio, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    scanning, most = list[BleakScanner](), list[int]()
    start, stop = BleakScanner.start, BleakScanner.stop

    async def begin(self: BleakScanner) -> None:
        scanning.append(self)
        most.append(len(scanning))
        await start(self)

    async def end(self: BleakScanner) -> None:
        scanning.remove(self)
        await stop(self)

    monkeypatch.setattr(BleakScanner, "start", begin)
    monkeypatch.setattr(BleakScanner, "stop", end)
    switched_on(radio, 2)
    links = [BleLink(choice("1")), BleLink(choice("2"))]
    seen = await asyncio.gather(*(link.open() for link in links))
    assert [each.name for each in seen] == ["Probe 1", "Probe 2"]
    await until(lambda: not scanning)
    assert max(most) == 1
    for link in links:
        await link.close()


async def test_a_scan_lists_the_strongest_first(radio: Radio, probe: Probe) -> None:
    others = [switched_on(radio, 2, rssi_dbm=-40), switched_on(radio, 3, rssi_dbm=-80)]
    async with heard(probe, *others):
        found = await scan(1.0)
    assert [(each.name, each.rssi_dbm) for each in found] == [
        ("Probe 2", -40), ("Probe 1", -58), ("Probe 3", -80)
    ]  # fmt: skip


async def test_a_late_listener_hears_what_was_heard_just_now(radio: Radio, probe: Probe) -> None:
    async with advertisements() as early:
        while not (await anext(early)).name:
            pass
        radio.world.call(lambda: probe.peripheral.set_advertising(False))
        async with advertisements() as late:
            seen = await asyncio.wait_for(anext(late), DEADLINE_S)
    assert seen.address == probe.address


async def test_a_scan_that_hears_nothing_any_more_is_started_again(
    radio: Radio, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts, start = list[BleakScanner](), BleakScanner.start

    async def noted(self: BleakScanner) -> None:
        starts.append(self)
        await start(self)

    monkeypatch.setattr(BleakScanner, "start", noted)
    async with advertisements() as early:
        assert (await anext(early)).address == probe.address
        monkeypatch.setattr(ble_scanner, "SILENT_S", -1.0)
        async with advertisements() as late:
            assert (await asyncio.wait_for(anext(late), DEADLINE_S)).address == probe.address
            assert (await asyncio.wait_for(anext(early), DEADLINE_S)).address == probe.address
    assert len(starts) == 2


@ON_BUMBLE
async def test_a_scan_that_hangs_up_does_not_hold_its_listener(
    radio: Radio, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BleakScanner, "stop", hang)
    link = BleLink(choice("1"))
    await asyncio.wait_for(link.open(), DEADLINE_S)
    await link.close()
