"""The driver streams from a virtual belt, and finds it."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import partial
from math import inf

import numpy as np
import pytest
from structlog.testing import capture_logs

from biosensor_common.spec import DeviceInfo
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.vernier_respiration_belt import driver as driver_module
from biosensor_gateway.devices.vernier_respiration_belt.driver import (
    DRIVER,
    VernierSettings,
    identify,
    protocol,
    recognise,
)
from biosensor_gateway.devices.vernier_respiration_belt.simulator import SimulatedBelt, wire
from biosensor_gateway.devices.vernier_respiration_belt.simulator.wire import Command
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.streaming import silence as silence_module
from biosensor_gateway.transports import ble_choice
from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.tap import What
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import connected, streaming
from tests.rigs.polling import until
from tests.rigs.truth import assert_only_gaps

# The driver streams from a virtual belt: all of it, once, at the right time.
assert_true = partial(assert_only_gaps, near_s=0.1, latest_s=2.0)


@pytest.mark.parametrize("host_mtu", [517, 23])
async def test_every_sample_arrives_with_its_time(belt: SimulatedBelt) -> None:
    async with streaming(belt) as run:
        await until(run.sink.has(30, "force"))
        assert run.states == [State.CONNECTING, State.STREAMING]
    index = assert_true(belt, run.sink, "force")
    assert index == list(range(len(index)))
    assert np.isnan(run.sink.values("bpm")[0])
    assert np.isfinite(run.sink.values("bpm")[-1])
    assert run.sink.rows["quality"][0][0] == 0.0
    assert run.sink.rows["quality"][-1] == [1.0, 0.0]
    assert (run.sink.values("bat"), run.sink.values("rssi")) == ([76.0], [-62.0])
    assert (run.sink.lost_count("force"), run.sink.dropped_bytes) == (0, 0)


async def test_the_belt_says_who_it_is(
    belt: SimulatedBelt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ble_choice, "OTHERS_S", 0.5)
    async with connected(belt, device="") as connection:
        assert connection.info == DeviceInfo("", "GDX-RB", "0K2002Z5", "1.7.220")
        assert connection.rates == {"force": 10.0, "bpm": 10.0}


async def test_the_period_can_be_set(belt: SimulatedBelt) -> None:
    async with streaming(belt, period_ms=50) as run:
        await until(run.sink.has(40, "force"))
    assert run.sink.rates == {"force": 20.0, "bpm": 20.0}
    assert_true(belt, run.sink, "force")
    # By the samples' numbers: when the first one arrives is not up to the belt.
    np.testing.assert_allclose(np.diff(run.sink.device_times["force"]), 0.05)


async def test_the_belt_is_stopped_and_set_free_at_the_end(
    belt: SimulatedBelt, commands: list[Command]
) -> None:
    for _ in range(2):
        async with streaming(belt) as run:
            await until(run.sink.has(5, "force"))
        assert commands[-2:] == [Command.STOP, Command.DISCONNECT]


@pytest.mark.usefixtures("hasty")
async def test_an_absent_belt_needs_its_button_pressed(
    radio: Radio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ble_choice, "SCAN_S", 0.3)
    async with streaming(SimulatedBelt(radio.world, radio)) as run:
        await until(lambda: run.supervisor.last_error)
        assert "press its button" in str(run.supervisor.last_error)
        assert State.DISCOVERING in run.states
        assert State.BACKOFF not in run.states


async def test_the_battery_is_asked_for_while_measuring(
    belt: SimulatedBelt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "STATUS_PERIOD_S", 0.3)
    async with streaming(belt) as run:
        await until(run.sink.has(3, "bat"))
        belt.apply(Fault(FaultKind.LOW_BATTERY, 4))
        await until(lambda: run.sink.values("bat")[-1] == 4)
        await run.goes_on(5, "force")
    index = assert_true(belt, run.sink, "force")
    assert index == list(range(len(index)))
    assert run.sink.lost_count("force") == 0


def test_defaults_are_enough() -> None:
    settings = VernierSettings(sensor="vernier_respiration_belt", unit="0K2002Z5")
    assert (settings.device, settings.period_ms) == ("", 100)


# Which advertisements are belts.
ADDRESS = "E0:F5:BD:94:6A:1B"


def test_a_belt_is_found_with_its_serial_number_and_its_address() -> None:
    found = recognise(Advertisement(ADDRESS, "GDX-RB 0K2002Z5", -61))
    settings = {"unit": "0K2002Z5", "device": ADDRESS}
    assert found == Found("vernier_respiration_belt", "GDX-RB 0K2002Z5", settings, -61)


def test_a_belt_without_a_serial_number_is_known_by_its_address() -> None:
    found = recognise(Advertisement(ADDRESS, "GDX-RB"))
    assert found is not None
    assert found.settings == {"unit": ADDRESS, "device": ADDRESS}


@pytest.mark.parametrize("name", ["", "GDX-HD 0K2002Z5", "GDX-RBX 0K2002Z5", "gdx"])
def test_other_devices_are_none(name: str) -> None:
    assert identify(Advertisement(ADDRESS, name)) is None
    assert recognise(Advertisement(ADDRESS, name)) is None


SERIAL = "0K2002Z5"
ADDRESS_AT, ADDRESS_BYTES = 78, 6


def test_the_address_is_replaced_and_the_rest_is_read_alike() -> None:
    info = wire.device_info("GDX-RB", SERIAL)
    address = slice(ADDRESS_AT, ADDRESS_AT + ADDRESS_BYTES)
    assert any(info[address])
    # In packets of 20 bytes, as over a small MTU.
    events = [
        Event(t=0.0, link=0, what=What.CAME, data=info[at : at + 20].hex())
        for at in range(0, len(info), 20)
    ]
    told = Redaction(lambda _: False, DRIVER.identifiers).of(events, [SERIAL])
    joined = b"".join(each.bytes for each in told)
    assert joined[address] != info[address]
    assert SERIAL.encode() not in joined
    assert sum(joined) % 256 == sum(info) % 256
    before, after = protocol.parse_device_info(info), protocol.parse_device_info(joined)
    assert before is not None
    assert after is not None
    assert (after.order_code, after.firmware) == (before.order_code, before.firmware)


# Whatever happens to a belt or to the link to it, on BlueZ too, the driver comes back.

# Whatever happens to a belt or the link to it, the driver comes back and says so.


def measure_for_a_while(monkeypatch: pytest.MonkeyPatch, *seconds: float) -> None:
    """Have belts fall silent so long after their first starts."""
    measure = vars(SimulatedBelt)["_measure"]
    limits_s = iter(seconds)

    async def measure_then_stop(self: SimulatedBelt) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(next(limits_s, None)):
                await measure(self)

    monkeypatch.setattr(SimulatedBelt, "_measure", measure_then_stop)


@pytest.mark.usefixtures("hasty")
async def test_a_belt_that_falls_silent_is_started_again(
    radio: Radio, commands: list[Command], monkeypatch: pytest.MonkeyPatch
) -> None:
    measure_for_a_while(monkeypatch, 0.5)
    with SimulatedBelt(radio.world, radio) as belt, capture_logs() as logs:
        async with streaming(belt) as run:
            await until(lambda: commands.count(Command.START) == 2)
            await run.goes_on(5, "force")
            assert run.supervisor.connections == 1
        assert_true(belt, run.sink, "force")
    assert any("enabling again" in log["event"] for log in logs)


@pytest.mark.usefixtures("hasty")
async def test_a_belt_that_stays_silent_is_connected_again(
    radio: Radio, commands: list[Command], monkeypatch: pytest.MonkeyPatch
) -> None:
    measure_for_a_while(monkeypatch, 0.5, 0.0)
    monkeypatch.setattr(silence_module, "PATIENCE_SAMPLES", 5)
    monkeypatch.setattr(driver_module, "PATIENCE_S", 0.5)
    with SimulatedBelt(radio.world, radio) as belt:
        async with streaming(belt) as run:
            await until(lambda: run.supervisor.last_error)
            assert "no data of bpm, force" in str(run.supervisor.last_error)
            await until(lambda: commands.count(Command.START) == 3)
            await run.goes_on(5, "force")
            assert State.BACKOFF not in run.states
            assert run.supervisor.connections == 2


async def test_a_belt_that_has_just_been_woken_is_greeted_twice(
    belt: SimulatedBelt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "WAKING_LIMIT_S", 0.1)
    belt.apply(Fault(FaultKind.LATE, 0.15))
    async with streaming(belt) as run:
        await until(run.sink.has(5, "force"))
        assert run.states == [State.CONNECTING, State.STREAMING]


@ON_BUMBLE
async def test_a_belt_that_takes_long_to_connect_still_tells_battery_and_signal(
    belt: SimulatedBelt,
) -> None:
    belt.apply(Fault(FaultKind.LATE, 4.6))
    began_s = belt.world.clock()
    async with streaming(belt) as run:
        await asyncio.sleep(30.0)
        assert not run.supervisor.is_connected
        await until(run.sink.has(5, "force"))
        assert (run.sink.values("bat"), run.sink.values("rssi")) == ([76.0], [-62.0])
        assert began_s < run.sink.times["rssi"][0] < belt.world.clock() - 30.0


async def test_a_belt_that_does_not_answer_in_time_is_left_alone(
    belt: SimulatedBelt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "WAKING_LIMIT_S", 0.1)
    belt.apply(Fault(FaultKind.LATE, 6.0))
    async with streaming(belt) as run:
        await until(lambda: State.BACKOFF in run.states)
        assert "does not answer INIT" in str(run.supervisor.last_error)


async def test_a_link_lost_while_asking_is_one_loss(
    belt: SimulatedBelt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "STATUS_PERIOD_S", 0.01)
    async with streaming(belt) as run:
        await until(run.sink.has(5, "force"))
        # A question is on its way before the link is lost.
        belt.apply(Fault(FaultKind.STALL, inf))
        await asyncio.sleep(0.1)
        belt.apply(Fault(FaultKind.DROP, 0.5))
        await until(lambda: run.supervisor.last_error)
        assert "the connection was cut" in str(run.supervisor.last_error)
