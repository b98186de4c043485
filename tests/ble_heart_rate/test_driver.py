"""The driver against a virtual strap on the virtual radio, under its supervisor."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncGenerator, Callable, Generator, Sequence
from contextlib import asynccontextmanager
from math import inf
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from biosensor_common.sensors.ble_heart_rate import SENSOR
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway import supervisor as supervisor_module
from biosensor_gateway.devices.ble_heart_rate import driver as driver_module
from biosensor_gateway.devices.ble_heart_rate import strap as strap_module
from biosensor_gateway.devices.ble_heart_rate.driver import (
    DRIVER,
    HeartRateStrapDriver,
    HeartRateStrapSettings,
)
from biosensor_gateway.devices.ble_heart_rate.simulator import SimulatedHeartRateStrap
from biosensor_gateway.outlets import Counters
from biosensor_gateway.settings import DeviceSettings
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from biosensor_gateway.sink import DeviceSink
from biosensor_gateway.supervisor import State, Supervisor
from biosensor_gateway.transports import ble_choice
from tests.rigs.polling import until

Floats = NDArray[np.float64]


class NotedSink(DeviceSink):
    """Notes what drivers emit on its way into LSL."""

    def __init__(self) -> None:
        super().__init__(DeviceIdentity("ble_heart_rate", uuid.uuid4().hex))
        self.rows: dict[str, list[float]] = {stream.data_name: [] for stream in SENSOR.streams}
        self.times: dict[str, list[float]] = {stream.data_name: [] for stream in SENSOR.streams}
        self._kept: dict[str, Counters] = {}

    @property
    def counters(self) -> dict[str, Counters]:
        return super().counters or self._kept

    def close(self) -> None:
        self._kept = self.counters
        super().close()

    def emit_at(self, data_name: str, samples: ArrayLike, lsl_times: Sequence[float]) -> None:
        super().emit_at(data_name, samples, lsl_times)
        self.rows[data_name] += np.asarray(samples, np.float64).ravel().tolist()
        self.times[data_name] += lsl_times

    def has(self, count: int, *data_names: str) -> Callable[[], bool]:
        return lambda: all(len(self.rows[name]) >= count for name in data_names)


class Run:
    """A strap and the supervisor that keeps it connected."""

    def __init__(self, **settings: Any) -> None:
        self.sink = NotedSink()
        self.states: list[State] = []
        model = HeartRateStrapSettings(
            sensor="ble_heart_rate", unit=self.sink.identity.unit, **settings
        )
        make = DRIVER.make(model, self.sink)
        self.supervisor = Supervisor(make, self.sink, self.states.append)


@asynccontextmanager
async def streaming(**settings: Any) -> AsyncGenerator[Run]:
    """Run until the block ends; then nothing may have been refused or be half closed."""
    run = Run(**settings)
    task = asyncio.create_task(run.supervisor.run())
    try:
        yield run
    finally:
        task.cancel()
        await asyncio.wait({task}, timeout=20)
    assert run.states[-1] is State.STOPPED
    assert {each.refused for each in run.sink.counters.values()} <= {0}
    run.sink.close()


@pytest.fixture
def world() -> Generator[World]:
    with World() as world:
        yield world


@pytest.fixture
def radio(world: World) -> Generator[Radio]:
    radio = Radio(world)
    with virtual_bluetooth(radio):
        yield radio


@pytest.fixture
def strap(world: World, radio: Radio) -> Generator[SimulatedHeartRateStrap]:
    wearer = Wearer(seed=3, heart_rate_bpm=110)
    with SimulatedHeartRateStrap(world, radio, wearer=wearer, rssi_dbm=-67) as strap:
        yield strap


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(ble_choice, "RIVALS_S", 0.5)


def assert_part(part: Sequence[float], whole: Floats) -> slice:
    """Assert that everything came once, in order and without a hole; return where it lies."""
    values = np.asarray(part)
    count = len(values)
    starts = [k for k in range(len(whole) - count + 1) if np.allclose(whole[k : k + count], values)]
    assert starts, "what was emitted is no part of what was sent"
    return slice(starts[0], starts[0] + count)


async def test_every_stream_fills_with_what_the_strap_sent(strap: SimulatedHeartRateStrap) -> None:
    async with streaming(**strap.settings) as run:
        await until(run.sink.has(6, "hr", "ibi", "quality"))
        assert run.states == [State.CONNECTING, State.STREAMING]
    for name in ("hr", "ibi"):
        assert_part(run.sink.rows[name], strap.truth.samples(name).values[:, 0])
    assert run.sink.rows["bat"] == [87]
    assert run.sink.rows["rssi"] == [-67]
    assert set(run.sink.rows["quality"]) == {1}
    assert run.sink.dropped_bytes == 0


async def test_beats_are_where_they_were(strap: SimulatedHeartRateStrap) -> None:
    async with streaming(**strap.settings) as run:
        await until(run.sink.has(20, "ibi"))
    truth = strap.truth.samples("ibi")
    place = assert_part(run.sink.rows["ibi"], truth.values[:, 0])
    errors = np.array(run.sink.times["ibi"]) - truth.times[place]
    # The packet that brings a beat comes up to a second later.
    assert np.median(np.abs(errors)) < 0.25


async def test_the_device_says_who_it_is(strap: SimulatedHeartRateStrap) -> None:
    run = Run(**strap.settings)
    driver = DRIVER.make(settings_of(strap), run.sink)()
    try:
        info = (await driver.connect()).info
    finally:
        await driver.close()
    assert (info.manufacturer, info.model) == ("Virtual Straps", "Heart Strap")
    assert (info.serial_number, info.firmware_version) == ("0001", "1.0")


def settings_of(strap: SimulatedHeartRateStrap) -> HeartRateStrapSettings:
    return HeartRateStrapSettings(sensor="ble_heart_rate", unit="one", **strap.settings)


async def test_without_a_device_in_the_settings_the_only_one_is_taken(
    strap: SimulatedHeartRateStrap,
) -> None:
    async with streaming() as run:
        await until(run.sink.has(1, "hr"))
    assert_part(run.sink.rows["hr"], strap.truth.samples("hr").values[:, 0])


async def test_two_straps_are_not_guessed_between(
    world: World, radio: Radio, strap: SimulatedHeartRateStrap
) -> None:
    other = SimulatedHeartRateStrap(world, radio, address="C8:25:00:00:00:02", name="Other 2")
    with other:
        async with streaming() as run:
            await until(lambda: run.supervisor.last_error)
            error = str(run.supervisor.last_error)
            assert str(strap.settings["device"]) in error
            assert str(other.settings["device"]) in error
        async with streaming(device="Other 2") as run:
            await until(run.sink.has(1, "hr"))
        assert_part(run.sink.rows["hr"], other.truth.samples("hr").values[:, 0])


async def test_the_strap_may_be_taken_off_and_put_on_again(
    strap: SimulatedHeartRateStrap,
) -> None:
    async with streaming(**strap.settings) as run:
        await until(run.sink.has(2, "hr", "quality"))
        strap.apply(Fault(FaultKind.OFF_BODY, inf))
        await until(lambda: run.sink.rows["quality"][-2:] == [0, 0])
        beats = len(run.sink.rows["hr"])
        await until(lambda: run.sink.rows["quality"][-3:] == [0, 0, 0])
        assert len(run.sink.rows["hr"]) == beats
        strap.clear(FaultKind.OFF_BODY)
        await until(lambda: run.sink.rows["quality"][-1] == 1)
        await until(run.sink.has(beats + 1, "hr"))
    assert run.supervisor.connections == 1
    assert min(run.sink.rows["hr"]) > 0


async def test_a_battery_that_notifies_is_not_polled(strap: SimulatedHeartRateStrap) -> None:
    async with streaming(**strap.settings) as run:
        await until(run.sink.has(1, "bat", "hr"))
        strap.apply(Fault(FaultKind.LOW_BATTERY, 4))
        await until(lambda: run.sink.rows["bat"][-1] == 4)
    assert run.sink.rows["bat"] == [87, 4]


@pytest.mark.parametrize("kind", [FaultKind.DROP, FaultKind.RESTART])
async def test_the_strap_is_back_after_a_break(
    strap: SimulatedHeartRateStrap, kind: FaultKind
) -> None:
    async with streaming(**strap.settings) as run:
        await until(run.sink.has(3, "hr"))
        strap.apply(Fault(kind, 1.0))
        await until(lambda: State.DISCOVERING in run.states)
        count = len(run.sink.rows["ibi"])
        await until(run.sink.has(count + 3, "ibi"))
        assert run.supervisor.connections == 2
    truth = strap.truth.samples("ibi").values[:, 0]
    assert_part(run.sink.rows["ibi"][:count], truth)
    assert_part(run.sink.rows["ibi"][count:], truth)
    assert len(run.sink.rows["ibi"]) <= len(truth)


async def test_a_silent_strap_is_connected_anew(
    strap: SimulatedHeartRateStrap, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert HeartRateStrapDriver.silence_limit_s == 15.0
    monkeypatch.setattr(HeartRateStrapDriver, "silence_limit_s", 2.0)
    async with streaming(**strap.settings) as run:
        await until(run.sink.has(2, "hr"))
        strap.apply(Fault(FaultKind.STALL, 3.0))
        await until(lambda: State.DISCOVERING in run.states)
        count = len(run.sink.rows["hr"])
        await until(run.sink.has(count + 2, "hr"))
        assert run.supervisor.connections >= 2


async def test_garbage_is_counted_and_never_emitted(strap: SimulatedHeartRateStrap) -> None:
    async with streaming(**strap.settings) as run:
        await until(run.sink.has(2, "hr"))
        strap.apply(Fault(FaultKind.GARBAGE, 20))
        await until(lambda: run.sink.dropped_bytes > 0)
        count = len(run.sink.rows["hr"])
        await until(run.sink.has(count + 2, "hr", "ibi"))
        assert run.supervisor.connections == 1
    for name in ("hr", "ibi"):
        assert_part(run.sink.rows[name], strap.truth.samples(name).values[:, 0])


async def test_an_absent_strap_is_waited_for(
    world: World, radio: Radio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ble_choice, "SCAN_S", 0.3)
    strap = SimulatedHeartRateStrap(world, radio)
    async with streaming(**strap.settings) as run:
        await until(lambda: run.supervisor.last_error)
        assert run.supervisor.connections == 0
        with strap:
            await until(run.sink.has(1, "quality"))


async def test_closing_disconnects(strap: SimulatedHeartRateStrap) -> None:
    async with streaming(**strap.settings) as run:
        await until(run.sink.has(1, "hr"))
    # Only who is not connected advertises.
    async with streaming(**strap.settings) as run:
        await until(run.sink.has(1, "hr"))


def test_limits() -> None:
    assert strap_module.BATTERY_PERIOD_S == 300.0
    assert driver_module.GOODBYE_LIMIT_S < supervisor_module.CLOSE_TIMEOUT_S / 2


def test_settings_of_another_sensor_are_a_mistake() -> None:
    with pytest.raises(TypeError, match="strap"):
        DRIVER.make(DeviceSettings(sensor="zephyr", unit="x"), NotedSink())
