"""Whatever happens to a belt or to the link to it, on BlueZ too, the driver comes back."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from math import inf

import numpy as np
import pytest
from structlog.testing import capture_logs

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.vernier_respiration_belt import driver as driver_module
from biosensor_gateway.devices.vernier_respiration_belt.simulator import SimulatedBelt
from biosensor_gateway.devices.vernier_respiration_belt.simulator.wire import Command
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.streaming import silence as silence_module
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import streaming
from tests.rigs.polling import until
from tests.rigs.vernier_respiration_belt import assert_true

# Whatever happens to a belt or the link to it, the driver comes back and says so.

SAMPLE_S = 0.1


def measure_for_a_while(monkeypatch: pytest.MonkeyPatch, *seconds: float) -> None:
    """Have belts fall silent so long after their first starts."""
    measure = vars(SimulatedBelt)["_measure"]
    limits_s = iter(seconds)

    async def measure_then_stop(self: SimulatedBelt) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(next(limits_s, None)):
                await measure(self)

    monkeypatch.setattr(SimulatedBelt, "_measure", measure_then_stop)


async def test_a_lost_link_is_made_again_and_the_gap_counted(belt: SimulatedBelt) -> None:
    async with streaming(belt) as run:
        await until(run.sink.has(10, "force"))
        belt.apply(Fault(FaultKind.DROP, 1.0))
        await until(lambda: run.supervisor.connections == 2)
        await run.goes_on(5, "force")
    assert_true(run.sink, belt)
    gap_s = np.diff(run.sink.times["force"]).max()
    assert run.sink.lost_count("force") == pytest.approx(gap_s / SAMPLE_S - 1, abs=1.5)


async def test_what_a_stalled_link_loses_is_counted(belt: SimulatedBelt) -> None:
    async with streaming(belt) as run:
        await until(run.sink.has(20, "force"))
        belt.apply(Fault(FaultKind.STALL, inf))
        # Long enough for a silence, too short for the driver to do anything about it.
        await until(lambda: belt.truth.unsent_count("force") >= 10)
        belt.clear(FaultKind.STALL)
        await until(lambda: run.sink.lost_count("force"))
        await run.goes_on(5, "force")
        assert run.supervisor.connections == 1
    assert_true(run.sink, belt)
    assert run.sink.lost_count("force") == belt.truth.unsent_count("force")


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
        assert_true(run.sink, belt)
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
