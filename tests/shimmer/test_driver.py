"""The driver against virtual units with several boards, on real serial ports."""

from __future__ import annotations

import re
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.shimmer.driver import Shimmer3Settings, conversation
from biosensor_gateway.devices.shimmer.simulator import (
    SimulatedEmgUnit,
    SimulatedExgUnit,
    SimulatedImuUnit,
    SimulatedShimmer3R,
)
from biosensor_gateway.devices.shimmer.simulator.device import SimulatedShimmer
from biosensor_gateway.doctor.device_test import run_device_test
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World
from tests.rigs.driver_run import Run, connected, supervised
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

MOTION = {"acc_low_noise", "acc_wide_range", "gyro", "mag"}
AIR = {"pressure", "temp"}
SAMPLES = 40


@pytest.fixture
def world() -> Generator[World]:
    with World() as made:
        yield made


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_CAP_S", 0.2)
    monkeypatch.setattr(conversation, "LISTEN_S", 0.2)
    monkeypatch.setattr(conversation, "QUIET_S", 0.1)


async def streams_of(device: SimulatedShimmer, **fields: Any) -> Run:
    """Run until samples of all streams that are on have come; each is what was measured."""
    run = Run(device, **fields)
    async with supervised(run):
        await until(lambda: run.sink.rates)
        regular = run.sink.rates.keys() - run.sink.silent
        await until(run.sink.has(SAMPLES, *regular))
    for name in regular:
        # A device may have run before, and notes a sample after it has left.
        places = assert_once_and_in_order(
            run.sink.rows[name][:SAMPLES], device.truth.samples(name).values
        )
        assert set(np.diff(places)) == {1}
    assert run.lost == {}
    assert run.sink.dropped_bytes == 0
    return run


def on(run: Run) -> set[str]:
    return {name for name, rows in run.sink.rows.items() if rows} - {"bat", "quality"}


@pytest.mark.parametrize(
    ("unit", "streams"),
    [
        (SimulatedExgUnit, {"ecg"}),
        (SimulatedEmgUnit, {"emg"}),
        (SimulatedImuUnit, set[str]()),
        (SimulatedShimmer3R, {"ecg"}),
    ],
)
async def test_what_is_on_in_the_device_is_what_comes(
    world: World, unit: type[SimulatedShimmer], streams: set[str]
) -> None:
    with unit(world, seed=1) as device:
        run = await streams_of(device)
    assert on(run) == streams | MOTION | AIR
    assert bool(run.sink.rows["quality"]) == ("ecg" in streams)
    # Where it would come from, a stream that is off has its rate, too.
    assert set(run.sink.rates.values()) == {128.0}
    assert ("quality" in run.sink.silent) == ("ecg" not in streams)


@pytest.mark.parametrize("firmware", [(0, 11, 0), (0, 15, 4), (0, 16, 11)], ids=str)
async def test_older_firmware_tells_its_calibration_in_another_way(
    world: World, firmware: tuple[int, int, int]
) -> None:
    with SimulatedExgUnit(world, seed=2, firmware=firmware) as device:
        run = await streams_of(device)
    assert on(run) == {"ecg"} | MOTION | AIR


@pytest.mark.parametrize("unit", [SimulatedExgUnit, SimulatedShimmer3R])
async def test_settings_choose_sensors_rate_and_what_the_exg_chips_do(
    world: World, unit: type[SimulatedShimmer]
) -> None:
    with unit(world, seed=3) as device:
        fields = {"sensors": "emg, gyro", "rate_hz": 500.0, "exg_bits": 16, "exg_gain": 6}
        run = await streams_of(device, **fields)
        assert on(run) == {"emg", "gyro"}
        assert set(run.sink.rates.values()) == {32768 / 66}
        # It is in flash: what is not named any more stays as it is.
        run = await streams_of(device, sensors="device")
        assert on(run) == {"emg", "gyro"}
        run = await streams_of(device, sensors="ecg", lead_off=True)
        assert on(run) == {"ecg"}
        assert run.sink.rows["quality"][-1] == [1.0] * 5
        run = await streams_of(device, sensors="ecg,pressure")
        assert on(run) == {"ecg"} | AIR
        assert not run.sink.rows["quality"]


async def test_an_electrode_that_comes_off_is_told(world: World) -> None:
    with SimulatedExgUnit(world, seed=4) as device:
        run = Run(device)
        async with supervised(run):
            await until(lambda: run.sink.rows["quality"][-1:] == [[1.0] * 5])
            device.apply(Fault(FaultKind.OFF_BODY, float("inf")))
            await until(lambda: run.sink.rows["quality"][-1] == [0.0] * 5)
            device.clear(FaultKind.OFF_BODY)
            await until(lambda: run.sink.rows["quality"][-1] == [1.0] * 5)


async def test_what_was_never_calibrated_is_said(world: World) -> None:
    with SimulatedImuUnit(world) as device, capture_logs() as logs:
        await streams_of(device)
    (entry,) = (each for each in logs if each["event"].startswith("typical values"))
    assert entry["streams"] == ["acc_wide_range"]


async def test_an_exg_that_is_wanted_of_another_board_is_said(world: World) -> None:
    with SimulatedImuUnit(world) as device, capture_logs() as logs:
        await streams_of(device, sensors="ecg")
    assert "the expansion board is no ExG board" in {each["event"] for each in logs}


async def test_a_test_of_the_device_misses_nothing_that_is_off(world: World) -> None:
    with SimulatedEmgUnit(world) as device:
        fields = {"sensor": "shimmer", "unit": "3D2C", "sensors": "emg,gyro", **device.settings}
        outcome = await run_device_test(Shimmer3Settings.model_validate(fields), 1.0)
    assert outcome.problems == []
    assert {name for name, each in outcome.streams.items() if each.samples} == {
        *("emg", "gyro", "bat"),
    }


async def test_a_device_without_a_sensor_that_is_on_is_refused_with_an_advice(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SimulatedImuUnit, "sensors", 0x002000)
    with SimulatedImuUnit(world) as device, pytest.raises(ProtocolError) as caught:
        async with connected(device):
            pass
    assert "set sensors" in str(caught.value)
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


def test_the_page_names_all_that_is_said() -> None:
    root = Path(__file__).parents[2]
    page = (root / "docs" / "sensors" / "shimmer.md").read_text(encoding="utf-8")
    driver = root / "gateway_win" / "biosensor_gateway" / "devices" / "shimmer" / "driver"
    said: set[str] = set()
    for path in driver.glob("*.py"):
        said |= set(re.findall(r'_log\.warning\("([^"]+)"', path.read_text(encoding="utf-8")))
    assert len(said) >= 6
    assert {text for text in said if text not in page} == set()
