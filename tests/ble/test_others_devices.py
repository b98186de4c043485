"""A choice that does not tell its device by id or address leaves others theirs."""

from __future__ import annotations

import asyncio

import pytest

from biosensor_common.errors import TransportReason
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from tests.rigs.probe import Probe
from tests.rigs.probe_link import choice, generic_choice, refusal, switched_on

pytestmark = pytest.mark.usefixtures("hurry")


async def looked_for(chosen: Choice) -> None:
    """Have it looked for once, in vain."""
    assert (await refusal(BleLink(chosen).open())).reason is TransportReason.ABSENT


@pytest.mark.parametrize("device", ["", "1", "Probe 1", "A0:9E:1A:00:00:01"])
async def test_a_device_of_a_kind_of_its_own_is_left_to_that_kind(
    radio: Radio, device: str
) -> None:
    special, generic = choice(device), generic_choice()
    await looked_for(special)
    probe = switched_on(radio, 1)
    error = await refusal(BleLink(generic).open())
    assert error.reason is TransportReason.ABSENT
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
    error = await refusal(BleLink(late).open())
    assert error.reason is TransportReason.ABSENT
    assert probe.address in str(error)
    other = switched_on(radio, 2)
    second, first = BleLink(late), BleLink(chosen)
    assert (await second.open()).address == other.address
    assert (await first.open()).address == probe.address
    await second.close()
    await first.close()


async def test_two_that_look_at_the_same_time_get_one_each(probe: Probe) -> None:
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
