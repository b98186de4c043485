"""The driver against a virtual belt on the virtual radio, under its supervisor."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncGenerator, Callable, Generator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from math import inf
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from structlog.testing import capture_logs

from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.sensors.vernier_respiration_belt import SENSOR
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway import supervisor as supervisor_module
from biosensor_gateway.devices.vernier_respiration_belt import driver as driver_module
from biosensor_gateway.devices.vernier_respiration_belt.driver import DRIVER, VernierSettings
from biosensor_gateway.devices.vernier_respiration_belt.simulator import SimulatedBelt
from biosensor_gateway.devices.vernier_respiration_belt.simulator.firmware import BeltFirmware
from biosensor_gateway.devices.vernier_respiration_belt.simulator.wire import Command
from biosensor_gateway.outlets import Counters
from biosensor_gateway.settings import DeviceSettings
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World
from biosensor_gateway.sink import DeviceSink
from biosensor_gateway.supervisor import State, Supervisor
from biosensor_gateway.transports import ble_choice
from tests.rigs.polling import until

SAMPLE_S = 0.1


class NotedSink(DeviceSink):
    """Notes what drivers emit on its way into LSL."""

    def __init__(self) -> None:
        super().__init__(DeviceIdentity("vernier_respiration_belt", uuid.uuid4().hex))
        self.rows: dict[str, list[list[float]]] = {each.data_name: [] for each in SENSOR.streams}
        self.times: dict[str, list[float]] = {each.data_name: [] for each in SENSOR.streams}
        self.info = DeviceInfo()
        self.rates: Mapping[str, float] = {}
        self._kept: dict[str, Counters] = {}

    @property
    def counters(self) -> dict[str, Counters]:
        return super().counters or self._kept

    @property
    def lost_samples(self) -> int:
        """Of the force; the rate's are the same ones."""
        force, *_ = (each for name, each in self.counters.items() if name.endswith("force"))
        return force.lost

    def open(self, info: DeviceInfo, rates: Mapping[str, float]) -> None:
        super().open(info, rates)
        self.info, self.rates = info, rates

    def close(self) -> None:
        self._kept = self.counters
        super().close()

    def emit_at(self, data_name: str, samples: ArrayLike, lsl_times: Sequence[float]) -> None:
        super().emit_at(data_name, samples, lsl_times)
        width = len(SENSOR.stream(data_name).channels)
        self.rows[data_name] += np.asarray(samples, np.float64).reshape(-1, width).tolist()
        self.times[data_name] += lsl_times

    def values(self, data_name: str) -> list[float]:
        return [row[0] for row in self.rows[data_name]]

    def has(self, count: int, *data_names: str) -> Callable[[], bool]:
        return lambda: all(len(self.rows[name]) >= count for name in data_names)


class Run:
    """A belt's driver and the supervisor that keeps it connected."""

    def __init__(self, **settings: Any) -> None:
        self.sink = NotedSink()
        self.states: list[State] = []
        model = VernierSettings(
            sensor="vernier_respiration_belt", unit=self.sink.identity.unit, **settings
        )
        make = DRIVER.make(model, self.sink)
        self.supervisor = Supervisor(make, self.sink, self.states.append)

    async def goes_on(self) -> None:
        """Wait until another second was measured."""
        await until(self.sink.has(len(self.sink.rows["force"]) + 10, "force"))


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
def radio(world: World, request: pytest.FixtureRequest) -> Generator[Radio]:
    radio = Radio(world, host_mtu=getattr(request, "param", 517))
    with virtual_bluetooth(radio):
        yield radio


@pytest.fixture
def belt(world: World, radio: Radio) -> Generator[SimulatedBelt]:
    with SimulatedBelt(world, radio, jitter_s=0.02, warm_up_s=1.0) as belt:
        yield belt


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[Command]:
    """What the belt was told; each is short enough to come in one piece."""
    told: list[Command] = []
    hear = BeltFirmware.hear

    def noted(self: BeltFirmware, fragment: bytes) -> list[bytes]:
        if fragment[4] in (Command.START, Command.STOP, Command.DISCONNECT):
            told.append(Command(fragment[4]))
        return hear(self, fragment)

    monkeypatch.setattr(BeltFirmware, "hear", noted)
    return told


def measure_for_a_while(monkeypatch: pytest.MonkeyPatch, *seconds: float) -> None:
    """Have belts fall silent so long after their first starts."""
    measure = vars(SimulatedBelt)["_measure"]
    limits_s = iter(seconds)

    async def measure_then_stop(self: SimulatedBelt) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(next(limits_s, None)):
                await measure(self)

    monkeypatch.setattr(SimulatedBelt, "_measure", measure_then_stop)


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)


def places(emitted: Sequence[float], truth: NDArray[np.float64]) -> NDArray[np.intp]:
    """Where each emitted sample is in the truth; every one must be there, once and in order."""
    indices = [int(np.flatnonzero(truth == value)[0]) for value in emitted]
    assert all(np.diff(indices) > 0)
    return np.asarray(indices)


def assert_true(sink: NotedSink, belt: SimulatedBelt, *, within_s: float) -> NDArray[np.intp]:
    """Compare values and stamps with what the belt measured; return which samples arrived."""
    truth = belt.truth.samples("force")
    index = places(sink.values("force"), truth.values[:, 0])
    errors = np.asarray(sink.times["force"]) - np.asarray(truth.times)[index]
    assert np.abs(errors).max() < within_s
    rates = belt.truth.samples("bpm").values[index, 0]
    np.testing.assert_array_equal(sink.values("bpm"), rates)
    assert sink.times["bpm"] == sink.times["force"]
    return index


@pytest.mark.parametrize("radio", [517, 23], indirect=True)
async def test_every_sample_arrives_with_its_time(belt: SimulatedBelt) -> None:
    async with streaming(**belt.settings) as run:
        await until(run.sink.has(30, "force"))
        assert run.states == [State.CONNECTING, State.STREAMING]
    index = assert_true(run.sink, belt, within_s=0.1)
    assert index.tolist() == list(range(len(index)))
    assert np.isnan(run.sink.values("bpm")[0])
    assert np.isfinite(run.sink.values("bpm")[-1])
    assert run.sink.rows["quality"][0][0] == 0.0
    assert run.sink.rows["quality"][-1] == [1.0, 0.0]
    assert (run.sink.values("bat"), run.sink.values("rssi")) == ([76.0], [-62.0])
    assert (run.sink.lost_samples, run.sink.dropped_bytes) == (0, 0)


async def test_the_belt_says_who_it_is(belt: SimulatedBelt) -> None:
    async with streaming() as run:
        await until(run.sink.has(1, "force"))
    assert run.sink.info == DeviceInfo("", "GDX-RB", "0K2002Z5", "1.7.220")
    assert run.sink.rates == {"force": 10.0, "bpm": 10.0}


async def test_the_period_can_be_set(belt: SimulatedBelt) -> None:
    async with streaming(period_ms=50, **belt.settings) as run:
        await until(run.sink.has(40, "force"))
    assert run.sink.rates == {"force": 20.0, "bpm": 20.0}
    assert_true(run.sink, belt, within_s=0.1)
    assert np.diff(run.sink.times["force"]).mean() == pytest.approx(0.05, abs=0.002)


async def test_the_belt_is_stopped_and_set_free_at_the_end(
    belt: SimulatedBelt, commands: list[Command]
) -> None:
    for _ in range(2):
        async with streaming(**belt.settings) as run:
            await until(run.sink.has(5, "force"))
        assert commands[-2:] == [Command.STOP, Command.DISCONNECT]


async def test_an_absent_belt_needs_its_button_pressed(
    radio: Radio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ble_choice, "SCAN_S", 0.3)
    async with streaming(device="0K2002Z5") as run:
        await until(lambda: run.supervisor.last_error)
        assert "press its button" in str(run.supervisor.last_error)
        assert State.DISCOVERING in run.states
        assert State.BACKOFF not in run.states


async def test_a_lost_link_is_made_again_and_the_gap_counted(belt: SimulatedBelt) -> None:
    async with streaming(**belt.settings) as run:
        await until(run.sink.has(20, "force"))
        belt.apply(Fault(FaultKind.DROP, 1.0))
        await until(lambda: run.supervisor.connections == 2)
        await run.goes_on()
    assert_true(run.sink, belt, within_s=0.1)
    gap_s = np.diff(run.sink.times["force"]).max()
    assert run.sink.lost_samples == pytest.approx(gap_s / SAMPLE_S - 1, abs=1.5)


async def test_what_a_stalled_link_loses_is_counted(belt: SimulatedBelt) -> None:
    async with streaming(**belt.settings) as run:
        await until(run.sink.has(30, "force"))
        belt.apply(Fault(FaultKind.STALL, 1.5))
        await until(lambda: belt.truth.unsent_count("force") > 5)
        await until(lambda: run.sink.lost_samples)
        await run.goes_on()
        assert run.supervisor.connections == 1
    assert_true(run.sink, belt, within_s=0.1)
    assert run.sink.lost_samples == belt.truth.unsent_count("force")


async def test_a_belt_that_falls_silent_is_started_anew(
    radio: Radio, commands: list[Command], monkeypatch: pytest.MonkeyPatch
) -> None:
    measure_for_a_while(monkeypatch, 0.5)
    with SimulatedBelt(radio.world, radio) as belt, capture_logs() as logs:
        async with streaming(**belt.settings) as run:
            await until(lambda: commands.count(Command.START) == 2)
            await run.goes_on()
            assert run.supervisor.connections == 1
        assert_true(run.sink, belt, within_s=0.1)
    assert any("started anew" in log["event"] for log in logs)


async def test_a_belt_that_stays_silent_is_connected_anew(
    radio: Radio, commands: list[Command], monkeypatch: pytest.MonkeyPatch
) -> None:
    measure_for_a_while(monkeypatch, 0.5, 0.0)
    monkeypatch.setattr(driver_module, "PATIENCE_PERIODS", 5)
    monkeypatch.setattr(driver_module, "PATIENCE_S", 0.5)
    with SimulatedBelt(radio.world, radio) as belt:
        async with streaming(**belt.settings) as run:
            await until(lambda: run.supervisor.last_error)
            assert "measures nothing" in str(run.supervisor.last_error)
            await until(lambda: commands.count(Command.START) == 3)
            await run.goes_on()
            assert State.BACKOFF not in run.states
            assert run.supervisor.connections == 2


async def test_a_belt_that_refuses_is_left_alone_for_a_while(belt: SimulatedBelt) -> None:
    belt.apply(Fault(FaultKind.REFUSE, inf))
    async with streaming(**belt.settings) as run:
        await until(lambda: State.BACKOFF in run.states)
        assert "refuses INIT" in str(run.supervisor.last_error)
        belt.clear(FaultKind.REFUSE)
        await until(run.sink.has(5, "force"))


async def test_a_belt_that_has_just_been_woken_is_greeted_twice(
    belt: SimulatedBelt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "WAKING_LIMIT_S", 0.2)
    belt.apply(Fault(FaultKind.LATE, 0.3))
    async with streaming(**belt.settings) as run:
        await until(run.sink.has(5, "force"))
        assert run.states == [State.CONNECTING, State.STREAMING]


async def test_a_belt_that_does_not_answer_in_time_is_left_alone(
    belt: SimulatedBelt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "WAKING_LIMIT_S", 0.1)
    belt.apply(Fault(FaultKind.LATE, 6.0))
    async with streaming(**belt.settings) as run:
        await until(lambda: State.BACKOFF in run.states)
        assert "does not answer INIT" in str(run.supervisor.last_error)


async def test_garbage_costs_no_sample(belt: SimulatedBelt) -> None:
    async with streaming(**belt.settings) as run:
        await until(run.sink.has(20, "force"))
        belt.apply(Fault(FaultKind.GARBAGE, 64))
        await until(lambda: run.sink.dropped_bytes == 64)
        await run.goes_on()
    index = assert_true(run.sink, belt, within_s=0.1)
    assert index.tolist() == list(range(len(index)))
    assert run.sink.lost_samples == 0


async def test_the_battery_is_asked_for_while_measuring(
    belt: SimulatedBelt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "STATUS_PERIOD_S", 0.3)
    async with streaming(**belt.settings) as run:
        await until(run.sink.has(3, "bat"))
        belt.apply(Fault(FaultKind.LOW_BATTERY, 4))
        await until(lambda: run.sink.values("bat")[-1] == 4)
        await run.goes_on()
    index = assert_true(run.sink, belt, within_s=0.1)
    assert index.tolist() == list(range(len(index)))
    assert run.sink.lost_samples == 0


async def test_a_belt_that_is_taken_off_becomes_loose_and_loses_its_rate(
    belt: SimulatedBelt,
) -> None:
    async with streaming(**belt.settings) as run:
        await until(lambda: [1.0, 0.0] in run.sink.rows["quality"])
        belt.apply(Fault(FaultKind.OFF_BODY, inf))
        await until(lambda: run.sink.rows["quality"][-1] == [0.0, -1.0])
        assert np.isnan(run.sink.values("bpm")[-1])
        belt.clear(FaultKind.OFF_BODY)
        await until(lambda: run.sink.rows["quality"][-1] == [1.0, 0.0])


async def test_a_link_lost_while_asking_is_one_loss(
    belt: SimulatedBelt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "STATUS_PERIOD_S", 0.0)
    async with streaming(**belt.settings) as run:
        await until(run.sink.has(5, "force"))
        belt.apply(Fault(FaultKind.DROP, 0.5))
        await until(lambda: run.supervisor.last_error)
        assert "the connection was cut" in str(run.supervisor.last_error)


def test_settings_of_another_sensor_are_refused() -> None:
    with pytest.raises(TypeError):
        DRIVER.make(DeviceSettings(sensor="zephyr", unit="1"), NotedSink())


def test_defaults_are_enough() -> None:
    settings = VernierSettings(sensor="vernier_respiration_belt", unit="0K2002Z5")
    assert (settings.device, settings.period_ms) == ("", 100)


async def test_closing_before_connecting_does_nothing() -> None:
    model = VernierSettings(sensor="vernier_respiration_belt", unit="0K2002Z5")
    driver = DRIVER.make(model, NotedSink())()
    await driver.close()


async def test_a_radio_that_is_off_is_said(radio: Radio) -> None:
    radio.available = False
    model = VernierSettings(sensor="vernier_respiration_belt", unit="0K2002Z5")
    driver = DRIVER.make(model, NotedSink())()
    with pytest.raises(TransportError) as caught:
        await driver.connect()
    assert caught.value.reason is TransportReason.UNAVAILABLE
    await driver.close()
