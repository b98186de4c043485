"""The driver against the virtual Cortex, under its supervisor."""

from __future__ import annotations

import contextlib
import random
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.emotiv_insight.driver.emitter import EmotivEmitter
from biosensor_gateway.devices.emotiv_insight.driver.protocol import Sample
from biosensor_gateway.devices.emotiv_insight.simulator import (
    EPOC_X,
    INSIGHT_1_GYRO,
    INSIGHT_2,
    Circumstances,
    Licence,
    Metrics,
    Release,
    Timing,
    User,
)
from biosensor_gateway.simulation.world import World
from tests.emotiv_insight.steering import SteeredCortex
from tests.rigs.driver_run import supervised
from tests.rigs.emitter_sink import EmitterSink

if TYPE_CHECKING:
    from tests.emotiv_insight.conftest import InsightRun

# The driver against the virtual Cortex, under its supervisor.

Eventually = Callable[[Callable[[], bool]], Awaitable[None]]
Kept = Callable[..., contextlib.AbstractAsyncContextManager["InsightRun"]]
QUICK = Timing(found_s=0.05, scan_s=0.3, connect_s=0.05, silence_s=3.0)


@pytest.fixture
def world() -> Iterator[World]:
    with World() as living:
        yield living


@pytest.fixture
def kept(make_run: Callable[..., InsightRun], hasty: None, monkeypatch: pytest.MonkeyPatch) -> Kept:
    """Keep a driver connected to a virtual Cortex until the block ends."""

    @contextlib.asynccontextmanager
    async def run(cortex: SteeredCortex, **settings: Any) -> AsyncGenerator[InsightRun]:
        for variable, text in cortex.environment.items():
            monkeypatch.setenv(variable, text)
        async with supervised(make_run(**{**cortex.settings, **settings})) as made:
            yield made

    return run


def assert_true(run: InsightRun, cortex: SteeredCortex, *data_names: str) -> None:
    """All that arrived was sent, in this order and once; what is missing was counted."""
    for name in data_names:
        sent = cortex.truth.samples(name).values
        arrived = np.array(run.sink.rows[name])
        assert len(arrived)
        position = 0
        for row in arrived:
            while not np.allclose(sent[position], row, rtol=1e-6, atol=1e-6, equal_nan=True):
                position += 1
                assert position < len(sent), f"{name}: what arrived was not sent, or not so"
            position += 1


@pytest.mark.parametrize(("model", "rate"), [(INSIGHT_2, 32.0), (INSIGHT_1_GYRO, 128.0)])
async def test_other_insights(
    world: World, kept: Kept, eventually: Eventually, model: Any, rate: float
) -> None:
    with SteeredCortex(world, model=model, timing=QUICK, seed=3) as cortex:
        async with kept(cortex) as run:
            await eventually(run.sink.has(20, "eeg", "mot"))
            if model is INSIGHT_1_GYRO:
                await eventually(run.sink.has(20, "gyro"))
        assert_true(run, cortex, "eeg", "mot", *(("gyro",) if run.sink.rows["gyro"] else ()))
        assert run.sink.rates["mot"] == rate
        # What never comes has no nominal rate.
        assert run.sink.rates["gyro"] == (rate if run.sink.rows["gyro"] else 0.0)
        assert not run.sink.losses


async def test_a_headset_of_another_model_is_refused(
    world: World, kept: Kept, eventually: Eventually
) -> None:
    with SteeredCortex(world, model=EPOC_X, timing=QUICK, seed=3) as cortex:
        async with kept(cortex) as run:
            await eventually(lambda: "EPOCX-A1B2C3D4 is no Insight; " in run.error)
            assert not run.sink.rows["eeg"]
        # A session would be drawn from the licence for it.
        assert "createSession" not in cortex.calls


@pytest.mark.parametrize(
    ("version", "metrics"),
    [("2.2.0", None), ("2.7.0", None), *(("3.8.1", metrics) for metrics in Metrics)],
)
async def test_other_versions(
    world: World, kept: Kept, eventually: Eventually, version: str, metrics: Metrics | None
) -> None:
    with SteeredCortex(
        world, Circumstances(release=Release(version, metrics)), timing=QUICK, seed=4
    ) as cortex:
        async with kept(cortex) as run:
            await eventually(run.sink.has(2, "eeg", "met", "dev"))
        assert_true(run, cortex, "eeg", "met", "dev")


@pytest.mark.parametrize("licence", [Licence.NONE, Licence.METRICS, Licence.EEG])
async def test_licences(world: World, kept: Kept, eventually: Eventually, licence: Licence) -> None:
    with (
        SteeredCortex(
            world,
            Circumstances(user=User(licence=licence), unlicensed_metrics_s=0.5),
            timing=QUICK,
            seed=5,
        ) as cortex,
        capture_logs() as logs,
    ):
        async with kept(cortex) as run:
            await eventually(run.sink.has(2, "mot", "pow", "met", "dev"))
            cortex.close_connections(1001)
            await eventually(lambda: run.states.count(State.STREAMING) == 2)
            is_denied = Licence.EEG not in licence
            await eventually(lambda: ("does not cover raw EEG" in run.error) is is_denied)
        assert_true(run, cortex, "mot", "pow", "met", "dev")
        assert bool(run.sink.rows["eeg"]) is (Licence.EEG in licence)
    said = [entry for entry in logs if "does not cover raw EEG" in entry["event"]]
    # Once a connection.
    assert len(said) == 2 * is_denied


async def test_a_counted_licence_is_drawn_from_once(
    world: World, kept: Kept, eventually: Eventually
) -> None:
    with SteeredCortex(world, Circumstances(user=User(session_quota=12)), timing=QUICK) as cortex:
        async with kept(cortex) as run:
            for connections in (1, 2):
                await eventually(run.sink.has(10 * connections, "eeg"))
                cortex.close_connections(1001)
                await eventually(lambda n=connections: run.states.count(State.STREAMING) > n)
        assert cortex.calls.count("authorize") == 1


async def test_losses_are_counted_exactly(world: World, kept: Kept, eventually: Eventually) -> None:
    with SteeredCortex(world, timing=QUICK, seed=6) as cortex:
        async with kept(cortex) as run:
            await eventually(run.sink.has(20, "eeg"))
            cortex.drop_samples(5)
            await eventually(lambda: run.sink.losses.get("eeg") == 5)
            cortex.skip_seconds(2)
            await eventually(lambda: run.sink.losses.get("eeg") == 5 + 256)
            rows = len(run.sink.rows["eeg"])
            await eventually(run.sink.has(rows + 50, "eeg"))
        assert run.sink.losses == {"eeg": 261, "eeg_status": 261}
        assert_true(run, cortex, "eeg", "eeg_status")


@pytest.mark.parametrize("seconds", [-3.0, 3.0, 3600.0, -3600.0])
async def test_a_clock_that_is_set_loses_and_invents_nothing(
    world: World, kept: Kept, eventually: Eventually, seconds: float
) -> None:
    with SteeredCortex(world, timing=QUICK, seed=7) as cortex:
        async with kept(cortex) as run:
            await eventually(run.sink.has(50, "eeg", "mot"))
            cortex.time_jump(seconds)
            rows = len(run.sink.rows["eeg"])
            await eventually(run.sink.has(rows + 100, "eeg"))
        assert_true(run, cortex, "eeg", "mot")
        assert not run.sink.losses


async def test_repeated_interpolated_and_marked_samples(
    world: World, kept: Kept, eventually: Eventually
) -> None:
    with SteeredCortex(world, timing=QUICK, seed=8) as cortex:
        async with kept(cortex) as run:
            await eventually(run.sink.has(10, "eeg"))
            cortex.repeat_samples(20)
            cortex.interpolate(20)
            cortex.mark("stimulus", 7)
            rows = len(run.sink.rows["eeg"])
            await eventually(run.sink.has(rows + 60, "eeg"))
        assert_true(run, cortex, "eeg", "eeg_status")
        status = np.array(run.sink.rows["eeg_status"])
        assert (status[:, 1].sum(), status[:, 3].sum()) == (20, 1)
        assert len(set(run.sink.device_times["eeg"])) == len(status)
        assert not run.sink.losses


async def test_a_token_that_expires_is_renewed(
    world: World, kept: Kept, eventually: Eventually
) -> None:
    with SteeredCortex(world, timing=QUICK, seed=9) as cortex:
        async with kept(cortex) as run:
            await eventually(run.sink.has(20, "eeg"))
            cortex.expire_token()
            rows = len(run.sink.rows["eeg"])
            await eventually(run.sink.has(rows + 20, "eeg"))
            assert run.states.count(State.STREAMING) == 1
            cortex.close_connections(1001)
            await eventually(lambda: run.states.count(State.STREAMING) == 2)
            rows = len(run.sink.rows["eeg"])
            await eventually(run.sink.has(rows + 20, "eeg"))
        assert cortex.calls.count("authorize") == 2
        assert_true(run, cortex, "eeg")


@pytest.mark.parametrize("virtual", [False, True])
async def test_a_headset_that_is_switched_off_and_on(
    world: World, kept: Kept, eventually: Eventually, virtual: bool
) -> None:
    with SteeredCortex(world, timing=QUICK, is_virtual=virtual, seed=10) as cortex:
        async with kept(cortex) as run:
            await eventually(run.sink.has(20, "eeg"))
            cortex.switch_headset_off(virtual=virtual)
            await eventually(lambda: State.DISCOVERING in run.states)
            cortex.switch_headset_on()
            rows = len(run.sink.rows["eeg"])
            await eventually(run.sink.has(rows + 50, "eeg"))
        assert_true(run, cortex, "eeg")


@pytest.mark.parametrize("method", ["subscribe", "createSession", "queryHeadsets"])
async def test_a_reply_that_comes_twice_answers_once(
    world: World, kept: Kept, eventually: Eventually, method: str
) -> None:
    with SteeredCortex(
        world, Circumstances(data_before_reply=True), timing=QUICK, seed=15
    ) as cortex:
        cortex.duplicate_reply(method)
        async with kept(cortex) as run:
            await eventually(run.sink.has(50, "eeg"))
            assert run.states.count(State.STREAMING) == 1
        assert_true(run, cortex, "eeg")
        sent = cortex.truth.samples("eeg").values
        # What came before the reply to the subscription, too.
        assert run.sink.rows["eeg"][0] == pytest.approx(sent[0])


async def test_the_user_logs_in_and_approves(
    world: World, kept: Kept, eventually: Eventually
) -> None:
    with SteeredCortex(
        world, Circumstances(user=User(logged_in=False, approved=False)), timing=QUICK
    ) as cortex:
        async with kept(cortex) as run:
            await eventually(lambda: "getUserLogin" in cortex.calls)
            cortex.log_in()
            await eventually(lambda: "requestAccess" in cortex.calls)
            assert run.supervisor.state is State.CONNECTING
            cortex.approve()
            await eventually(run.sink.has(10, "eeg"))
            cortex.log_out()
            asked = cortex.calls.count("getUserLogin")
            await eventually(lambda: cortex.calls.count("getUserLogin") > asked + 1)
            assert run.supervisor.state is State.CONNECTING
            rows = len(run.sink.rows["eeg"])
            cortex.log_in()
            await eventually(run.sink.has(rows + 10, "eeg"))
        assert_true(run, cortex, "eeg")


async def test_wrong_credentials_are_told(
    world: World, kept: Kept, eventually: Eventually, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SteeredCortex(world, timing=QUICK) as cortex:
        async with kept(cortex) as run:
            await eventually(run.sink.has(1, "eeg"))
        async with kept(cortex) as run:
            monkeypatch.setenv("EMOTIV_CLIENT_SECRET", "wrong")
            await eventually(lambda: "check the client id and secret" in run.error)
        assert State.BACKOFF in run.states


# How exact stamps are after the clock of Cortex' computer was set.
CORTEX_S, LSL_S = 1.7e9, 5000.0
SET_AT_S, END_S = 20.0, 40.0
EEG_HZ, MOTION_HZ = 128, 64
LATE_S = 0.030
MOTION_LATER_S = 0.012


@pytest.mark.parametrize("set_back_s", [0.15, 0.307, 0.45, 3.0, 20.0])
def test_stamps_go_on_at_once(set_back_s: float) -> None:
    sink, rng = EmitterSink("emotiv_insight"), random.Random(1)
    emitter = EmotivEmitter(sink)
    emitter.connected(EEG_HZ, MOTION_HZ, headset_stayed=True)
    measured: list[float] = []
    sent: list[tuple[float, Sample]] = []
    for number in range(round(END_S * EEG_HZ)):
        true_s = number / EEG_HZ
        time_s = CORTEX_S + true_s - set_back_s * (true_s >= SET_AT_S)
        measured.append(true_s)
        sent.append((true_s, Sample("eeg", time_s, {"COUNTER": number % EEG_HZ, "T7": 4200.0}, {})))
        if number % 2 == 0:
            count = {"COUNTER_MEMS": number // 2 % MOTION_HZ, "ACCX": 1.0}
            sent.append((true_s + MOTION_LATER_S, Sample("mot", time_s, count, {})))
    arrival_s = 0.0
    stamps: list[float] = []
    for ready_s, sample in sorted(sent, key=lambda each: each[0]):
        arrival_s = max(arrival_s, LSL_S + ready_s + rng.uniform(0.0, LATE_S))
        emitter.take(sample, arrival_s)
        if sample.stream == "eeg":
            stamps.append(sink.mapped(sample.time_s))

    errors = [stamp - LSL_S - true for stamp, true in zip(stamps, measured, strict=True)]
    assert max(map(abs, errors)) < LATE_S + MOTION_LATER_S
    assert max(map(abs, errors[-EEG_HZ:])) < 0.003
    assert sink.losses == {}
