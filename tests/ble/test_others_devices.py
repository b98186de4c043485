"""A choice that does not tell its device by id or address leaves others theirs."""

from __future__ import annotations

import asyncio

import pytest

from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports import ble_choice
from biosensor_gateway.transports.ble import BleLink
from tests.ble.conftest import absence, heard
from tests.rigs.probe import Probe
from tests.rigs.probe_link import choice, generic_choice, switched_on

pytestmark = [pytest.mark.usefixtures("hurry")]


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


async def test_it_is_not_left_to_a_kind_that_nobody_looks_for(probe: Probe) -> None:
    link = BleLink(generic_choice())
    assert (await link.open()).address == probe.address
    await link.close()


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


async def test_who_names_an_address_gets_it(probe: Probe) -> None:
    """Two tables that name the same device are the user's own choice."""
    chosen = choice()
    first = BleLink(chosen)
    await first.open()
    await first.close()
    second = BleLink(generic_choice(probe.address))
    assert (await second.open()).address == probe.address
    await second.close()
