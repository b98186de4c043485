"""Whatever a Polar sensor refuses or loses, the driver goes on with what there is."""

from __future__ import annotations

from collections.abc import Callable
from math import inf

import numpy as np
import pytest
from structlog.testing import capture_logs

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.polar_h10 import driver as driver_module
from biosensor_gateway.devices.polar_h10.driver import PolarDriver
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.polar_h10.simulator.pmd import Measurement
from biosensor_gateway.devices.polar_h10.simulator.products import Quirks
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.transports import ble
from tests.polar_h10.steering import SteeredPolarH10
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import Run, connected, streaming
from tests.rigs.polar_h10 import assert_only_gaps
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

# Whatever happens to a Polar sensor or the link to it, the driver comes back and says so.

MakeSensor = Callable[..., SteeredPolarH10]


async def after_a_break(run: Run, break_it: Callable[[], None]) -> None:
    await until(run.sink.has(100, "ecg"))
    await until(run.sink.has(36, "acc"))
    break_it()
    await until(lambda: State.DISCOVERING in run.states)
    ecg, acc = len(run.sink.rows["ecg"]), len(run.sink.rows["acc"])
    await until(run.sink.has(ecg + 100, "ecg"))
    await until(run.sink.has(acc + 36, "acc"))
    await until(run.sink.has(1, "bat"))


async def test_a_lost_link_is_a_gap_of_known_length(sensor: MakeSensor) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        await after_a_break(run, lambda: h10.apply(Fault(FaultKind.DROP, 0.8)))
        lost = {name: run.sink.lost_count(name) for name in ("ecg", "acc")}
    assert_only_gaps(h10, run.sink)
    for name, rate in {"ecg": 130, "acc": 50}.items():
        stamps = np.array(run.sink.times[name])
        assert lost[name] == pytest.approx((np.diff(stamps) - 1 / rate).max() * rate, abs=6)


async def test_a_device_that_restarts_counts_again_and_loses_nothing_meanwhile(
    sensor: MakeSensor,
) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        await after_a_break(run, lambda: h10.apply(Fault(FaultKind.RESTART, 0.8)))
        lost = run.sink.lost_count("ecg")
    assert_only_gaps(h10, run.sink)
    assert lost == 0


async def test_measurements_that_went_on_are_started_again(sensor: MakeSensor) -> None:
    h10 = sensor(Quirks(keeps_streaming=True, announces_stops=True))
    async with streaming(h10) as run:
        await after_a_break(run, lambda: h10.apply(Fault(FaultKind.DROP, 0.8)))
    assert_only_gaps(h10, run.sink)


async def test_a_measurement_that_stops_is_started_again(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert driver_module.PATIENCE_S == 5.0
    monkeypatch.setattr(driver_module, "PATIENCE_S", 1.5)
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(73, "ecg"))
        with capture_logs() as logs:
            h10.stop_measurements(Measurement.ECG)
            await run.goes_on(146, "ecg")
        assert run.supervisor.connections == 1
        lost = run.sink.lost_count("ecg")
    assert_only_gaps(h10, run.sink)
    said = [entry["event"] for entry in logs]
    assert "the device stopped measuring" in said
    assert any("no data of ecg" in each and "enabling again" in each for each in said)
    assert lost > 100


async def test_a_silent_device_is_connected_again(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert PolarDriver.silence_limit_s == 15.0
    monkeypatch.setattr(ble, "REQUEST_LIMIT_S", 0.5)
    monkeypatch.setattr(driver_module, "PATIENCE_S", 1.0)
    monkeypatch.setattr(driver_module, "FULL_FRAME", 20)
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(73, "ecg"))
        h10.apply(Fault(FaultKind.STALL, inf))
        await until(lambda: State.DISCOVERING in run.states)
        assert "no data of acc, ecg" in str(run.supervisor.last_error)
        h10.clear(FaultKind.STALL)
        await run.goes_on(73, "ecg")
        assert run.supervisor.connections >= 2
    assert_only_gaps(h10, run.sink)


async def test_a_heart_rate_that_stops_alone_is_subscribed_to_again(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "DUE", {"hr": 2.0})
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(2, "hr"))
        h10.forget_heart_rate()
        await until(lambda: State.ENABLING in run.states)
        assert "no data of hr" in str(run.supervisor.last_error)
        await run.goes_on(2, "hr")
        await until(lambda: run.supervisor.last_error is None)
        assert run.supervisor.connections == 1
        assert run.sink.lost_count("ecg") == 0
    assert_only_gaps(h10, run.sink)


# A sensor that refuses to measure still has a heart rate, and is asked again.
MakeRefusing = Callable[..., SimulatedPolarH10]


@ON_BUMBLE
async def test_without_the_mtu_for_it_there_is_a_heart_rate_and_a_reason(
    sensor: MakeRefusing,
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


@ON_BUMBLE
async def test_what_was_refused_comes_as_soon_as_the_sensor_measures(sensor: MakeRefusing) -> None:
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


@ON_BUMBLE
async def test_what_was_refused_has_the_rate_that_was_asked_for(sensor: MakeRefusing) -> None:
    h10 = sensor()
    h10.apply(Fault(FaultKind.REFUSE, inf))
    async with streaming(h10, acc_rate_hz=200, ecg=False) as run:
        await until(lambda: "refuses acc (" in str(run.supervisor.last_error))
        assert run.sink.rates == {"acc": 200}
        h10.clear(FaultKind.REFUSE)
        await until(run.sink.has(50, "acc"))
        assert run.supervisor.connections == 1


@ON_BUMBLE
async def test_what_is_refused_is_told_to_who_connects(sensor: MakeRefusing) -> None:
    async with connected(sensor(Quirks(minimum_mtu=512)), acc=False) as info:
        assert info.denied.keys() == {"ecg"}
        assert (info.silent, info.refused) == ({"acc"}, {"acc"})
