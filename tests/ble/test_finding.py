"""Finding a Bluetooth LE device: by name or address, and leaving others' devices alone."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from bleak import BleakScanner
from structlog.testing import capture_logs

from biosensor_common.errors import ProtocolReason
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports import ble_choice, ble_scanner
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_scanner import advertisements, scan
from biosensor_gateway.transports.nearby import Advertisement
from tests.ble.conftest import absence, heard
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.polling import until
from tests.rigs.probe import DEADLINE_S, Probe, choice, generic_choice, refusal, switched_on

# Finding a Bluetooth LE device: which one it is, and the scan that all share.


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


# A device whose name is not heard is taken by its address.
ADDRESS = "00:55:DA:B0:3A:1F"


def by_name(seen: Advertisement) -> str | None:
    """Tell a kind as drivers do whose devices say it in their name alone."""
    return seen.name.removeprefix("Kind ") if seen.name.startswith("Kind ") else None


def test_the_address_alone_is_enough() -> None:
    choice = Choice(by_name, "Kind", ADDRESS.lower())
    assert choice.claims(Advertisement(ADDRESS), from_generic=False)
    assert not choice.claims(Advertisement("00:55:DA:B0:3A:20"), from_generic=False)
    assert not Choice(by_name, "Kind", "3A1F").claims(Advertisement(ADDRESS), from_generic=False)


# Two devices of one name: who was connected is never changed for somebody else.
NAME = "Probe 1"


@pytest.mark.usefixtures("hurry")
@pytest.mark.parametrize("device", ["", "1", NAME])
async def test_a_device_that_is_away_is_not_replaced_by_its_namesake(
    radio: Radio, probe: Probe, device: str
) -> None:
    chosen = choice(device)
    first = BleLink(chosen)
    assert (await first.open()).address == probe.address
    namesake = switched_on(radio, 2, NAME)
    probe.drop()
    await first.close()
    with capture_logs() as logs:
        for _ in range(2):
            async with heard(namesake):
                error = await absence(BleLink(chosen))
            assert f"({probe.address}) is not in range, only another" in str(error)
            assert f"({namesake.address}); press its button, or set `device`" in str(error)
    (warning,) = [each["event"] for each in logs if each["log_level"] == "warning"]
    assert warning == (
        f"another device also matches {device or 1} ({NAME} {namesake.address}); it is not used "
        f"instead of the one that was connected ({probe.address})"
    )
    probe.restore()
    again = BleLink(chosen)
    assert (await again.open()).address == probe.address
    await again.close()


@pytest.mark.usefixtures("hurry")
async def test_two_of_a_name_are_refused_by_address(radio: Radio, probe: Probe) -> None:
    namesake = switched_on(radio, 2, NAME)
    async with heard(probe, namesake):
        error = await refusal(BleLink(choice(NAME)).open())
    assert error.reason is ProtocolReason.REFUSED
    assert f"name {NAME} ({probe.address}, {namesake.address}); set `device`" in str(error)
    link = BleLink(choice(namesake.address))
    assert (await link.open()).address == namesake.address
    await link.close()


@pytest.mark.usefixtures("hurry")
@pytest.mark.parametrize(("device", "level"), [("", "info"), (NAME, "warning")])
async def test_an_address_is_proposed_for_what_was_not_told_by_one(
    probe: Probe, device: str, level: str
) -> None:
    chosen = choice(device)
    with capture_logs() as logs:
        for _ in range(2):
            link = BleLink(chosen)
            await link.open()
            await link.close()
    (proposal,) = [each for each in logs if "set device = " in each["event"]]
    assert proposal["log_level"] == level
    assert f'device = "{probe.address}"' in proposal["event"]


@pytest.mark.usefixtures("hurry")
@pytest.mark.parametrize("device", ["1", "A0:9E:1A:00:00:01"])
async def test_nothing_is_proposed_for_an_id_or_an_address(probe: Probe, device: str) -> None:
    link = BleLink(choice(device))
    with capture_logs() as logs:
        assert (await link.open()).address == probe.address
    assert not [each for each in logs if each["log_level"] != "debug"]
    await link.close()


# A choice that does not tell its device by id or address leaves others theirs.
@pytest.mark.usefixtures("hurry")
@pytest.mark.parametrize("device", ["", "1", "Probe 1", "A0:9E:1A:00:00:01"])
async def test_a_device_of_a_kind_of_its_own_is_left_to_that_kind(
    radio: Radio, device: str
) -> None:
    special, generic = choice(device), generic_choice()
    await absence(BleLink(special))
    probe = switched_on(radio, 1)
    async with heard(probe):
        error = await absence(BleLink(generic))
    assert f"other tables of the settings use (Probe 1 {probe.address})" in str(error)
    other = switched_on(radio, 2, "Thing")
    links = [BleLink(generic), BleLink(special)]
    found = await asyncio.gather(*(link.open() for link in links))
    assert [each.address for each in found] == [other.address, probe.address]
    for link in links:
        await link.close()


@pytest.mark.usefixtures("hurry")
async def test_it_is_not_left_to_a_kind_that_nobody_looks_for(probe: Probe) -> None:
    link = BleLink(generic_choice())
    assert (await link.open()).address == probe.address
    await link.close()


@pytest.mark.usefixtures("hurry")
async def test_what_another_has_connected_stays_its(radio: Radio, probe: Probe) -> None:
    """Also while its link is cut, and where both have no `device`."""
    chosen, late = choice(), choice()
    link = BleLink(chosen)
    await link.open()
    await link.close()
    async with heard(probe):
        error = await absence(BleLink(late))
    assert probe.address in str(error)
    other = switched_on(radio, 2)
    second, first = BleLink(late), BleLink(chosen)
    assert (await second.open()).address == other.address
    assert (await first.open()).address == probe.address
    await second.close()
    await first.close()


@pytest.mark.usefixtures("hurry")
async def test_two_that_look_at_the_same_time_get_one_each(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    # For one of them it is there, for the other one it is not.
    monkeypatch.setattr(ble_choice, "SCAN_S", 2.0)
    links = [BleLink(choice()), BleLink(choice())]
    outcomes = await asyncio.gather(*(link.open() for link in links), return_exceptions=True)
    assert sorted(isinstance(each, Exception) for each in outcomes) == [False, True]
    for link in links:
        await link.close()


@pytest.mark.usefixtures("hurry")
async def test_who_names_an_address_gets_it(probe: Probe) -> None:
    """Two tables that name the same device are the user's own choice."""
    chosen = choice()
    first = BleLink(chosen)
    await first.open()
    await first.close()
    second = BleLink(generic_choice(probe.address))
    assert (await second.open()).address == probe.address
    await second.close()
