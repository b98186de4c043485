"""A sensor that refuses to measure still has a heart rate, and is asked again."""

from __future__ import annotations

from collections.abc import Callable
from math import inf

import pytest
from structlog.testing import capture_logs

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.polar_h10.simulator.products import Quirks
from biosensor_gateway.simulation.faults import Fault, FaultKind
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import connected, streaming
from tests.rigs.polar_h10 import assert_only_gaps
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

MakeSensor = Callable[..., SimulatedPolarH10]

# What the sensor answers is the same on any rig; the waiting is not.
pytestmark = ON_BUMBLE


async def test_without_the_mtu_for_it_there_is_a_heart_rate_and_a_reason(
    sensor: MakeSensor,
) -> None:
    h10 = sensor(Quirks(minimum_mtu=512))
    with capture_logs() as logs:
        async with streaming(h10) as run:
            await until(run.sink.has(12, "hr", "quality"))
            await until(run.sink.has(5, "ibi"))
            # Nothing is given for it: neither the connection nor the state.
            assert run.supervisor.connections == 1
            assert run.states == [State.CONNECTING, State.STREAMING]
            assert run.supervisor.last_error == (
                "connected, but the device refuses acc, ecg (INVALID_MTU: its packets are too "
                "large for this Bluetooth adapter; use another one)"
            )
    assert_once_and_in_order(run.sink.rows["hr"], h10.truth.samples("hr").values)
    assert (run.sink.rows["ecg"], run.sink.rows["acc"]) == ([], [])
    said = [entry for entry in logs if entry["event"] == run.supervisor.last_error]
    assert [(each["log_level"], each["reason"]) for each in said] == [("warning", "refused")]


async def test_what_was_refused_comes_as_soon_as_the_sensor_measures(sensor: MakeSensor) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(73, "ecg"))
        h10.apply(Fault(FaultKind.REFUSE, inf))
        await until(lambda: run.supervisor.connections == 2)
        await run.goes_on(3, "hr")
        assert "the device refuses acc, ecg (INVALID_STATE" in str(run.supervisor.last_error)
        h10.clear(FaultKind.REFUSE)
        await run.goes_on(73, "ecg", "acc")
        await until(lambda: run.supervisor.last_error is None)
        assert run.supervisor.connections == 2
        assert State.BACKOFF not in run.states
    assert_only_gaps(h10, run.sink)


async def test_what_was_refused_has_the_rate_that_was_asked_for(sensor: MakeSensor) -> None:
    h10 = sensor()
    h10.apply(Fault(FaultKind.REFUSE, inf))
    async with streaming(h10, acc_rate_hz=200, ecg=False) as run:
        await until(lambda: "refuses acc (" in str(run.supervisor.last_error))
        assert run.sink.rates == {"acc": 200}
        h10.clear(FaultKind.REFUSE)
        await until(run.sink.has(50, "acc"))
        assert run.supervisor.connections == 1


async def test_what_is_refused_is_told_to_who_connects(sensor: MakeSensor) -> None:
    async with connected(sensor(Quirks(minimum_mtu=512)), acc=False) as info:
        assert info.denied.keys() == {"ecg"}
        assert (info.silent, info.refused) == ({"acc"}, {"acc"})


@pytest.mark.parametrize("host_mtu", [64])
async def test_a_real_small_mtu_is_what_it_refuses(sensor: MakeSensor) -> None:
    async with streaming(sensor(Quirks(minimum_mtu=65))) as run:
        await run.goes_on(3, "hr")
        assert "INVALID_MTU" in str(run.supervisor.last_error)
