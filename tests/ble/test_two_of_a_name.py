"""Two devices of one name: who was connected is never changed for somebody else."""

from __future__ import annotations

import pytest
from structlog.testing import capture_logs

from biosensor_common.errors import ProtocolReason
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports.ble import BleLink
from tests.ble.conftest import absence, heard
from tests.rigs.probe import Probe
from tests.rigs.probe_link import choice, refusal, switched_on

NAME = "Probe 1"

pytestmark = [pytest.mark.usefixtures("hurry")]


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
        f"another device answers to {device or 1} ({NAME} {namesake.address}); it is not taken in "
        f"place of the one that was connected ({probe.address})"
    )
    probe.restore()
    again = BleLink(chosen)
    assert (await again.open()).address == probe.address
    await again.close()


async def test_two_of_a_name_are_refused_by_address(radio: Radio, probe: Probe) -> None:
    namesake = switched_on(radio, 2, NAME)
    async with heard(probe, namesake):
        error = await refusal(BleLink(choice(NAME)).open())
    assert error.reason is ProtocolReason.REFUSED
    assert f"called {NAME} ({probe.address}, {namesake.address}); set `device`" in str(error)
    link = BleLink(choice(namesake.address))
    assert (await link.open()).address == namesake.address
    await link.close()


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


@pytest.mark.parametrize("device", ["1", "A0:9E:1A:00:00:01"])
async def test_nothing_is_proposed_for_an_id_or_an_address(probe: Probe, device: str) -> None:
    link = BleLink(choice(device))
    with capture_logs() as logs:
        assert (await link.open()).address == probe.address
    assert not [each for each in logs if each["log_level"] != "debug"]
    await link.close()
