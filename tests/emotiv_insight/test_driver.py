"""The driver against the virtual Cortex, under its supervisor."""

from __future__ import annotations

import contextlib
import random
from collections.abc import AsyncGenerator, Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from pydantic import ValidationError

from biosensor_gateway.devices.emotiv_insight import SPEC
from biosensor_gateway.devices.emotiv_insight.driver import (
    DEFAULT_URL,
    EmotivInsightSettings,
    is_loopback,
)
from biosensor_gateway.devices.emotiv_insight.driver.emitter import EmotivEmitter
from biosensor_gateway.devices.emotiv_insight.driver.protocol import Licence, Sample, licence
from biosensor_gateway.devices.emotiv_insight.simulator import (
    INSIGHT_1_GYRO,
    INSIGHT_2,
    Circumstances,
    Metrics,
    Release,
    Timing,
)
from biosensor_gateway.simulation.world import World
from tests.emotiv_insight.steering import SteeredCortex
from tests.rigs.driver_run import supervised
from tests.rigs.emitter_sink import EmitterSink
from tests.rigs.polling import eventually

if TYPE_CHECKING:
    from tests.emotiv_insight.conftest import InsightRun

# The driver against the virtual Cortex, under its supervisor.

Kept = Callable[..., contextlib.AbstractAsyncContextManager["InsightRun"]]
QUICK = Timing(found_s=0.05, scan_s=0.3, connect_s=0.05)


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
async def test_other_insights(world: World, kept: Kept, model: Any, rate: float) -> None:
    with SteeredCortex(world, model=model, timing=QUICK, seed=3) as cortex:
        async with kept(cortex) as run:
            await eventually(run.sink.has(20, "eeg", "mot"))
            if model is INSIGHT_1_GYRO:
                await eventually(run.sink.has(20, "gyro"))
        assert_true(run, cortex, "eeg", "mot", *(("gyro",) if run.sink.rows["gyro"] else ()))
        assert run.sink.rates["mot"] == rate
        # What never has a value is told, so that a recording is not said to lack it.
        assert run.sink.lacking["mot"] == _empty(run, "mot")
        # What never comes has no nominal rate.
        assert run.sink.rates["gyro"] == (rate if run.sink.rows["gyro"] else 0.0)
        assert not run.sink.losses


@pytest.mark.parametrize(
    ("version", "metrics"),
    [("2.2.0", None), ("2.7.0", None), *(("3.8.1", metrics) for metrics in Metrics)],
)
async def test_other_versions(
    world: World, kept: Kept, version: str, metrics: Metrics | None
) -> None:
    with SteeredCortex(
        world, Circumstances(release=Release(version, metrics)), timing=QUICK, seed=4
    ) as cortex:
        async with kept(cortex) as run:
            await eventually(run.sink.has(2, "eeg", "met", "dev"))
        assert_true(run, cortex, "eeg", "met", "dev")
        assert len(run.sink.lacking["met"]) == 1
        for name in ("met", "dev"):
            assert set(run.sink.lacking[name]) <= set(_empty(run, name))


def _empty(run: InsightRun, data_name: str) -> list[str]:
    """Labels of the channels without any value."""
    (labels,) = (each.labels for each in SPEC.streams if each.data_name == data_name)
    rows = run.sink.rows[data_name]
    return [label for at, label in enumerate(labels) if all(np.isnan(row[at]) for row in rows)]


@pytest.mark.parametrize("seconds", [-3.0, 3.0, 3600.0, -3600.0])
async def test_a_clock_that_is_set_loses_and_invents_nothing(
    world: World, kept: Kept, seconds: float
) -> None:
    with SteeredCortex(world, timing=QUICK, seed=7) as cortex:
        async with kept(cortex) as run:
            await eventually(run.sink.has(50, "eeg", "mot"))
            cortex.time_jump(seconds)
            rows = len(run.sink.rows["eeg"])
            await eventually(run.sink.has(rows + 100, "eeg"))
        assert_true(run, cortex, "eeg", "mot")
        assert not run.sink.losses


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


# What may be set for an Insight, and where its headsets may be.


def settings(**fields: Any) -> EmotivInsightSettings:
    return EmotivInsightSettings.model_validate({"sensor": "emotiv_insight", "unit": "u", **fields})


def test_the_defaults_just_work() -> None:
    assert settings().url == DEFAULT_URL == "wss://localhost:6868"
    assert (settings().license, settings().headset, settings().allow_remote) == ("", "", False)


def test_no_secret_is_a_setting() -> None:
    assert not [name for name in EmotivInsightSettings.model_fields
                if "client" in name or "secret" in name or "token" in name]  # fmt: skip


def test_every_field_is_described() -> None:
    assert all(field.description for field in EmotivInsightSettings.model_fields.values())


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "127.1.2.3", "[::1]"])
def test_this_computer_may_be_the_host(host: str) -> None:
    assert settings(url=f"wss://{host}:6868").url == f"wss://{host}:6868"


@pytest.mark.parametrize("host", ["lab-pc", "192.168.0.7", "localhost.example", "[2001:db8::1]"])
def test_another_computer_must_be_allowed(host: str) -> None:
    with pytest.raises(ValidationError, match="allow_remote"):
        settings(url=f"wss://{host}:6868")
    assert settings(url=f"wss://{host}:6868", allow_remote=True).allow_remote


@pytest.mark.parametrize(
    "url", ["ws://localhost:6868", "localhost", "wss://", "wss://u:p@localhost"]
)
def test_only_a_secured_url_without_a_password_is_one(url: str) -> None:
    with pytest.raises(ValidationError, match="should look like"):
        settings(url=url, allow_remote=True)


def test_a_debit_is_not_negative() -> None:
    assert settings(debit=0).debit == 0
    with pytest.raises(ValidationError):
        settings(debit=-1)


@pytest.mark.parametrize(("host", "loopback"), [("localhost", True), ("::1", True), ("", False)])
def test_loopback_is_told_by_name_or_address(host: str, loopback: bool) -> None:
    assert is_loopback(host) is loopback


def test_scopes_and_expiry_are_read() -> None:
    told = {"isOnline": True, "license": {"scopes": ["pm", "eeg"], "expired": True}}
    assert licence(told) == Licence(frozenset({"pm", "eeg"}), expired=True)
    assert not licence({"license": {"scopes": ["pm"], "expired": False}}).expired


@pytest.mark.parametrize("told", [None, [], {}, {"license": 7}, {"license": {"scopes": "eeg"}}])
def test_what_is_not_told_is_not_covered(told: object) -> None:
    assert licence(told) == Licence()
