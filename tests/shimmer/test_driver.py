"""The driver against virtual units with several boards, and what their settings take."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.registry import sensor
from biosensor_gateway.devices.shimmer.driver import (
    Shimmer3Settings,
    Wanted,
    conversation,
    recognise,
)
from biosensor_gateway.devices.shimmer.simulator import (
    SimulatedEmgUnit,
    SimulatedExgUnit,
    SimulatedImuUnit,
    SimulatedShimmer3R,
)
from biosensor_gateway.devices.shimmer.simulator.device import SimulatedShimmer
from biosensor_gateway.devices.shimmer.simulator.sensors import memory_of
from biosensor_gateway.doctor.device_test import run_device_test
from biosensor_gateway.simulation.world import World
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from tests.rigs.driver_run import Run, connected, streaming, supervised
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

# The driver against virtual units with several boards, on real serial ports.

MOTION = {"acc_low_noise", "acc_wide_range", "gyro", "mag"}
AIR = {"pressure", "temp"}
SAMPLES = 40


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


class NeverCalibrated(SimulatedImuUnit):
    """Its accelerometer of the wide range was never calibrated."""

    memory = replace(
        SimulatedImuUnit.memory, calibration=memory_of(*SimulatedImuUnit.motion[:3], None)
    )


class WithoutCoefficients(SimulatedImuUnit):
    """Its pressure sensor tells nothing about itself."""

    memory = replace(SimulatedImuUnit.memory, pressure_coefficients=b"\x01" * 22)


class LeftInItsTest(SimulatedExgUnit):
    """Its ExG chips were left with their test signal on."""

    # CH1SET is the fourth register; 5 is the test signal.
    registers = tuple(
        each[:3] + bytes([each[3] & 0xF0 | 5]) + each[4:] for each in SimulatedExgUnit.registers
    )


async def doubts_of(device: SimulatedShimmer, **fields: Any) -> str:
    """Return what is wrong in the status of a device that streams."""
    async with streaming(device, **fields) as run:
        await until(lambda: run.error)
        assert run.is_streaming()
        return run.error


async def test_a_calibrated_unit_is_beyond_doubt(world: World) -> None:
    with SimulatedImuUnit(world) as device:
        assert (await streams_of(device)).error == ""


@pytest.mark.parametrize(
    ("unit", "fields", "doubt"),
    [
        (NeverCalibrated, {}, "there was no calibration: acc_wide_range"),
        (SimulatedImuUnit, {"sensors": "ecg"}, "(31) is not an ExG board, so ecg has no meaning"),
        (SimulatedImuUnit, {"sensors": "emg"}, "(31) is not an ExG board, so emg has no meaning"),
        (LeftInItsTest, {}, "the ExG measures a test signal, not the body"),
        (WithoutCoefficients, {}, "refuses pressure, temp (the coefficients"),
    ],
)
async def test_values_that_may_be_wrong_or_are_withheld_are_said_in_the_status(
    world: World, unit: type[SimulatedShimmer], fields: dict[str, str], doubt: str
) -> None:
    with unit(world) as device:
        assert doubt in await doubts_of(device, **fields)


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
        text = path.read_text(encoding="utf-8")
        said |= set(re.findall(r'_log\.warning\("([^"]+)"', text))
        said |= set(re.findall(r'remarks\["[^"]+"\] = \(?\s*f?"([^"({:]+)', text))
    assert len(said) >= 7
    assert {text for text in said if text not in page} == set()


# What the settings of a Shimmer take, and how they refuse the rest.
def settings(**fields: object) -> Shimmer3Settings:
    named = {"sensor": "shimmer", "unit": "3D2C", "port": "COM7"}
    return Shimmer3Settings.model_validate({**named, **fields})


def test_by_default_all_is_left_as_the_device_has_it() -> None:
    assert settings().wanted == Wanted()


def test_names_choose_sensors() -> None:
    wanted = settings(sensors="ecg, gyro,pressure", rate_hz=500, exg_bits=16, exg_gain=8).wanted
    assert wanted == Wanted(frozenset({"ecg", "gyro", "pressure"}), 66, 16, 8)
    assert wanted.use == "ecg"


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"sensors": "ecg, eeg"}, "but has 'eeg'"),
        ({"sensors": ""}, "but has ''"),
        ({"sensors": "ecg,emg"}, "need the same chips"),
        ({"rate_hz": 0.4}, "should be 0, or from 1 to 2048"),
        ({"rate_hz": 4096.0}, "less than or equal to 2048"),
        ({"exg_gain": 5}, "should be 'usual', 1, 2, 3, 4, 6, 8 or 12"),
        ({"exg_bits": 20}, "should be 16 or 24"),
    ],
)
def test_what_makes_no_sense_is_refused(fields: dict[str, object], sentence: str) -> None:
    with pytest.raises(ValidationError) as caught:
        settings(**fields)
    assert sentence in str(caught.value)


@pytest.mark.parametrize("name", ["Shimmer3-3d2C", "Shimmer3R-3D2c", "Shimmer3R-3D2C-BT"])
def test_a_shimmer_is_known_by_its_name(name: str) -> None:
    found = recognise(SerialPort("COM7", name, "00:06:66:AA:3D:2C"))
    assert found is not None
    assert (found.sensor, found.name) == ("shimmer", name)
    assert found.settings == {"unit": "3D2C", "port": "COM7"}


@pytest.mark.parametrize("name", ["", "Shimmer3", "Shimmer3R-3D2C-BLE", "Shimmer2-3D2C", "HC-05"])
def test_other_ports_are_not(name: str) -> None:
    assert recognise(SerialPort("COM7", name)) is None


def test_nor_is_anything_of_bluetooth_le() -> None:
    assert recognise(Advertisement("AA:BB:CC:DD:EE:FF", "Shimmer3-3D2C")) is None


def test_a_name_that_does_not_tell_the_board_is_a_gsr_unit_s() -> None:
    assert sensor("shimmer").precedence < sensor("shimmer3_gsr").precedence
