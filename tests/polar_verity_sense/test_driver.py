"""The driver streams from virtual optical sensors, and finds them."""

from __future__ import annotations

from collections.abc import Callable
from math import inf

import numpy as np
import pytest
from structlog.testing import capture_logs

from biosensor_gateway.devices.polar_h10.simulator.pmd import Measurement
from biosensor_gateway.devices.polar_h10.simulator.products import Quirks
from biosensor_gateway.devices.polar_verity_sense.driver import (
    PolarVeritySenseSettings,
    identify,
    recognise,
)
from biosensor_gateway.devices.polar_verity_sense.simulator import (
    OH1,
    OLD_VERITY_SENSE,
    POLAR_360,
    SimulatedPolarVeritySense,
)
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.transports.nearby import Advertisement
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import connected, streaming
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

# The driver streams from virtual optical sensors: all of it, once, at the right time.

MakeSensor = Callable[..., SimulatedPolarVeritySense]
REGULAR = ("ppg", "acc", "gyro", "mag")


@ON_BUMBLE
@pytest.mark.parametrize(
    ("product", "ppg_hz", "asked_hz"), [(OLD_VERITY_SENSE, 55, 55), (OH1, 135, 135)]
)
async def test_the_rate_in_the_header_is_the_one_that_comes(
    sensor: MakeSensor, product: object, ppg_hz: int, asked_hz: int
) -> None:
    device = sensor(product=product)
    async with streaming(device, ppg_rate_hz=asked_hz, gyro=False, mag=False) as run:
        await until(run.sink.has(6 * ppg_hz, "ppg"))
        assert run.sink.rates["ppg"] == ppg_hz
        assert run.lost == {}
    spacing = np.diff(run.sink.times["ppg"])
    assert np.median(spacing) == pytest.approx(1 / ppg_hz, rel=0.05)


@ON_BUMBLE
async def test_with_intervals_the_heart_rate_comes_every_five_seconds(sensor: MakeSensor) -> None:
    verity = sensor()
    async with streaming(verity) as run:
        await until(run.sink.has(4, "hr"))
    assert np.median(np.diff(run.sink.times["hr"])) == pytest.approx(5.0, abs=0.1)
    assert not run.sink.lacking["quality"]
    async with streaming(verity, ppi=False) as run:
        await until(run.sink.has(6, "hr"))
        assert run.sink.rows["ppi"] == []
    assert np.isnan(run.sink.array("quality")[:, 1]).all()
    assert run.sink.lacking["quality"] == ["moving"]
    assert np.median(np.diff(run.sink.times["hr"])) == pytest.approx(1.0, abs=0.1)


@ON_BUMBLE
async def test_the_first_intervals_take_their_time_and_nobody_loses_patience(
    sensor: MakeSensor,
) -> None:
    verity = sensor(Quirks())
    async with streaming(verity) as run:
        for samples in (500, 1000):
            await until(run.sink.has(samples, "acc"))
        await until(run.sink.has(1, "ppi"))
        assert run.supervisor.connections == 1
    began_s = run.sink.times["ppg"][0]
    # That of the first batch's last beat is at most one interval before the batch.
    beats = np.array(run.sink.times["ppi"])
    assert beats[-1] - began_s > 20
    truth = verity.truth.samples("ppi")
    errors = beats - truth.times[: len(beats)]
    assert np.all((errors >= -0.05) & (errors < 1.0))


@ON_BUMBLE
async def test_sdk_mode_has_more_rates_and_neither_heart_rate_nor_intervals(
    sensor: MakeSensor,
) -> None:
    verity = sensor()
    fields = {
        "sdk_mode": True,
        "ppg_rate_hz": 176,
        "acc_rate_hz": 200,
        "acc_range_g": 2,
        "gyro_rate_hz": 26,
        "gyro_range_deg_s": 250,
        "mag_rate_hz": 20,
    }
    async with connected(verity, **fields) as info:
        assert info.rates == {"ppg": 176, "acc": 104, "gyro": 26, "mag": 20}
        assert info.silent == {"hr", "ppi"}
        assert info.due == {}
    async with streaming(verity, **fields) as run:
        await until(run.sink.has(300, "ppg"))
        await until(run.sink.has(50, "acc", "gyro", "mag"))
        assert run.lost == {}
        assert run.supervisor.connections == 1
    for name in REGULAR:
        # In counts that mean less, since the range is smaller.
        assert_once_and_in_order(run.sink.rows[name], verity.truth.samples(name).values)
    assert (run.sink.rows["hr"], run.sink.rows["ppi"]) == ([], [])
    # It was taken out of the mode at the end.
    async with streaming(verity, ppi=False) as again:
        await until(again.sink.has(2, "hr"))


@ON_BUMBLE
@pytest.mark.parametrize("sdk_mode", [False, True])
async def test_what_a_host_before_us_left_on_does_not_decide_the_mode(
    sensor: MakeSensor, *, sdk_mode: bool
) -> None:
    left = (Measurement.ACC,) if sdk_mode else (Measurement.SDK_MODE,)
    verity = sensor(Quirks(left_streaming=left, first_intervals_s=3.0))
    async with streaming(verity, sdk_mode=sdk_mode) as run:
        await until(run.sink.has(100, "ppg"))
        if not sdk_mode:
            await until(run.sink.has(1, "hr"))
    assert (run.sink.rows["hr"] == []) is sdk_mode


@ON_BUMBLE
async def test_an_oh1_says_what_it_lacks_and_sends_the_rest(sensor: MakeSensor) -> None:
    device = sensor(product=OH1)
    with capture_logs() as logs:
        async with connected(device, sdk_mode=True) as info:
            assert info.refused == {"gyro", "mag", "ppi"}
            assert info.silent == {"hr", "ppi"}
    said = [each["event"] for each in logs if each["log_level"] == "warning"]
    assert "it has no SDK mode; set sdk_mode = false, or update it" in said
    assert "the device cannot measure everything requested" in said


@ON_BUMBLE
async def test_a_360_has_two_diodes(sensor: MakeSensor) -> None:
    device = sensor(product=POLAR_360)
    async with streaming(device, gyro=False, mag=False) as run:
        await until(run.sink.has(60, "ppg", "acc"))
        assert (run.sink.rates["ppg"], run.sink.rates["acc"]) == (22, 50)
    light = run.sink.array("ppg")
    assert np.isnan(light[:, 2:]).all()
    # What it does not have is told, so that a recording is not said to lack it.
    assert run.sink.lacking["ppg"] == ("LED3", "ambient")
    assert_once_and_in_order(light[:, :2].tolist(), device.truth.samples("ppg").values)


@ON_BUMBLE
async def test_a_rate_that_nobody_could_know_is_declared_before_its_samples_come(
    sensor: MakeSensor,
) -> None:
    verity = sensor()
    verity.apply(Fault(FaultKind.REFUSE, inf))
    async with streaming(verity, mag=False) as run:
        await run.goes_on(1, "hr")
        assert "the device refuses acc, gyro, ppg, ppi (" in str(run.supervisor.last_error)
        verity.clear(FaultKind.REFUSE)
        await until(run.sink.has(100, "acc"))
        await until(run.sink.has(2, "ppi"))
        assert run.sink.rates == {"ppg": 55, "acc": 52, "gyro": 52, "mag": 50}
        await until(lambda: run.supervisor.last_error is None)


# Which advertisements are Polar's optical sensors, and the settings they make.
HEART_RATE = frozenset({"0000180d-0000-1000-8000-00805f9b34fb"})


def seen(name: str) -> Advertisement:
    return Advertisement("A0:9E:1A:00:00:01", name, -58, HEART_RATE)


@pytest.mark.parametrize("model", ["Sense", "Verity Sense", "OH1", "360"])
def test_each_product_is_found_by_its_name(model: str) -> None:
    found = recognise(seen(f"Polar {model} A1B2C3D4"))
    assert found is not None
    assert (found.sensor, found.rssi_dbm) == ("polar_verity_sense", -58)
    assert found.name == f"Polar {model} A1B2C3D4"
    settings = PolarVeritySenseSettings.model_validate({"sensor": found.sensor, **found.settings})
    assert (settings.unit, settings.device) == ("A1B2C3D4", "A0:9E:1A:00:00:01")


@pytest.mark.parametrize("name", ["", "Polar", "Polar H10 A1B2C3D4", "Polar 360", "Sense A1B2C3D4"])
def test_other_names_are_other_devices(name: str) -> None:
    assert identify(seen(name)) is None
    assert recognise(seen(name)) is None


# The virtual optical sensors speak as published: byte by byte, and through plain bleak.
