"""What holds for any virtual device, whoever wrote it."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest

from biosensor_gateway.devices.registry import declaration, driver
from biosensor_gateway.simulation.faults import Fault, FaultKind, Kind, Untidiness
from biosensor_gateway.simulation.virtual_device import IMPOSSIBLE, Link, VirtualDevice
from tests.contracts.conftest import class_of, every, is_recording
from tests.rigs.driver_run import streaming
from tests.rigs.polling import until

if TYPE_CHECKING:
    from tests.contracts.conftest import Make

LONG_S = 3600.0
VALUES: dict[Kind, float] = {
    FaultKind.LOW_BATTERY: 4.0,
    FaultKind.GARBAGE: 20.0,
    FaultKind.DRIFT: 150.0,
    Untidiness.STRAY: 3.0,
    Untidiness.RATE: 100.0,
    Untidiness.PACE: 4.0,
    Untidiness.BUNDLED: 3.0,
}
KEPT = 3


def fault(kind: Kind) -> Fault:
    return Fault(kind, VALUES.get(kind, LONG_S))


def test_every_fault_is_possible_or_there_is_a_reason(name: str) -> None:
    found = class_of(name)
    impossible = found.impossible()
    missing = {*FaultKind, *Untidiness} - found.effects.keys() - impossible.keys()
    assert not missing
    assert not found.effects.keys() & impossible.keys()
    assert all(why and why[0].islower() and why[-1] != "." for why in impossible.values())


def test_what_its_link_cannot_do_is_no_fault_of_its_own(name: str) -> None:
    found = class_of(name)
    assert found.on_air == (found.link is Link.BLUETOOTH_LE)
    said_twice = IMPOSSIBLE[found.link].keys() & found.expected.impossible.keys()
    assert not said_twice


def test_what_it_says_of_its_streams_is_about_declared_ones(name: str) -> None:
    found = class_of(name)
    names = {stream.data_name for stream in declaration(found.sensor).streams}
    expected = found.expected
    assert names >= found.filled.keys() | found.rates_hz.keys() | expected.by_agent
    assert names >= set(expected.without_contact) | expected.unstamped_s.keys()


async def test_a_fault_that_it_cannot_have_is_refused(device: VirtualDevice) -> None:
    for kind in {*FaultKind, *Untidiness} - device.effects.keys():
        with pytest.raises(ValueError, match=f"cannot have the fault {kind.value}"):
            device.apply(fault(kind))
        with pytest.raises(ValueError, match=f"cannot have the fault {kind.value}"):
            device.schedule(fault(kind), 1.0)


async def test_what_has_not_begun_can_be_ended(device: VirtualDevice) -> None:
    for kind in (*FaultKind, *Untidiness):
        device.clear(kind)


async def test_its_settings_are_those_of_its_driver(device: VirtualDevice) -> None:
    model = driver(device.sensor).settings
    fields = {"sensor": device.sensor, "unit": "1", **device.settings}
    assert fields.keys() <= model.model_fields.keys()
    model.model_validate(fields)


@every(*FaultKind, *Untidiness)
async def test_it_can_be_switched_off_in_any_fault_and_nothing_of_it_goes_on(
    make: Make, kind: Kind
) -> None:
    device = make()

    def at_work() -> int:
        return len(asyncio.all_tasks(device.world.loop))

    before = device.world.call(at_work)
    with device:
        device.apply(fault(kind))
    await until(lambda: device.world.call(at_work) <= before)


async def test_of_the_truth_only_so_much_is_kept(
    name: str, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    if is_recording(name):
        return
    with make(kept=KEPT) as device:
        for variable, text in device.environment.items():
            monkeypatch.setenv(variable, text)
        async with streaming(device) as run:
            await until(lambda: any(len(rows) > 2 * KEPT for rows in run.sink.rows.values()))
        kept = [len(device.truth.samples(each).times) for each in device.truth.data_names]
        assert max(kept) == KEPT
