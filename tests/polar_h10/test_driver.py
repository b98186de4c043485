"""The driver streams from virtual Polar sensors: all of it, once, at the right time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from structlog.testing import capture_logs

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices import ble_session as session_module
from biosensor_gateway.devices.polar_h10 import SPEC
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.polar_h10.simulator.products import Firmware, Quirks
from biosensor_gateway.simulation.faults import Fault, FaultKind
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import connected, streaming
from tests.rigs.polar_h10 import assert_only_gaps
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

MakeSensor = Callable[..., SimulatedPolarH10]


async def test_every_stream_fills_with_what_the_sensor_sent(sensor: MakeSensor) -> None:
    h10 = sensor(rssi_dbm=-49)
    async with streaming(h10) as run:
        await until(run.sink.has(4, "hr", "ibi", "quality"))
        await until(run.sink.has(200, "ecg"))
        await until(run.sink.has(100, "acc"))
        assert run.states == [State.CONNECTING, State.STREAMING]
        # The truth may be ahead by what is under way.
        lost = [run.sink.lost_count(stream.data_name) for stream in SPEC.streams]
    for name in ("hr", "ibi", "ecg", "acc"):
        places = assert_once_and_in_order(run.sink.rows[name], h10.truth.samples(name).values)
        assert places == list(range(places[0], places[0] + len(places)))
    # From the first sample on.
    for name in ("ecg", "acc"):
        first = h10.truth.samples(name).values[: len(run.sink.rows[name])]
        np.testing.assert_allclose(run.sink.rows[name], first, rtol=1e-6)
    assert run.sink.rows["bat"] == [[87]]
    assert run.sink.rows["rssi"] == [[-49]]
    # Its first measurement may come before it has found a beat.
    _, *qualities = run.sink.values("quality")
    assert set(qualities) == {1}
    assert set(lost) == {0}
    assert run.sink.dropped_bytes == 0


# On BlueZ the time is that of a busy machine; what comes there is held against the truth below.
@ON_BUMBLE
async def test_samples_are_stamped_when_they_were_measured(sensor: MakeSensor) -> None:
    h10 = sensor(Quirks(sampling_deviation=0.015), drift_ppm=100, jitter_s=0.05)
    async with streaming(h10) as run:
        await until(run.sink.has(750, "ecg"))
    for name in ("ecg", "acc"):
        stamps = np.array(run.sink.times[name])
        errors = stamps - h10.truth.samples(name).times[: len(stamps)]
        # Not earlier than measured, and late by a radio's delay, not by a frame's 560 ms.
        assert np.all(errors > -0.02)
        assert np.median(errors) < 0.2
        assert all(a < b for a, b in pairwise(stamps))
        spacing: NDArray[np.float64] = np.diff(errors[len(errors) // 2 :])
        assert np.sqrt(np.mean(np.square(spacing))) < 1e-3


@pytest.mark.parametrize("rate", [25, 200])
async def test_the_rate_of_the_settings_is_the_stream_s(sensor: MakeSensor, rate: int) -> None:
    async with connected(sensor(), acc_rate_hz=rate) as info:
        assert info.rates == {"ecg": 130, "acc": rate}
        assert (info.info.manufacturer, info.info.model) == ("Polar Electro Oy", "H10")
        assert info.info.serial_number == "A1B2C3D4"


async def test_what_is_not_wanted_is_not_started(sensor: MakeSensor) -> None:
    h10 = sensor()
    async with streaming(h10, ecg=False, acc=False) as run:
        await until(run.sink.has(2, "hr", "ibi"))
    assert (run.sink.rows["ecg"], run.sink.rows["acc"]) == ([], [])
    assert "ecg" not in h10.truth.data_names
    async with connected(sensor(), ecg=False) as info:
        assert (info.silent, set(info.rates)) == ({"ecg"}, {"acc"})


@pytest.mark.parametrize("firmware", [Firmware.OLD, Firmware.HEART_RATE_ONLY])
async def test_without_a_pmd_service_it_is_a_heart_rate_strap(
    sensor: MakeSensor, firmware: Firmware
) -> None:
    h10 = sensor(Quirks(firmware=firmware))
    with capture_logs() as logs:
        async with streaming(h10) as run:
            await until(run.sink.has(1, "hr", "ibi", "quality"))
            h10.apply(Fault(FaultKind.DROP, 0.2))
            await until(lambda: run.supervisor.connections == 2)
            await run.goes_on(1, "hr")
    assert sum("update it with Polar Flow" in entry["event"] for entry in logs) == 1
    assert run.sink.rows["ecg"] == []


@pytest.mark.parametrize("host_mtu", [64])
async def test_a_small_mtu_is_enough(sensor: MakeSensor) -> None:
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(200, "ecg"))
        await until(run.sink.has(50, "acc"))
        assert run.sink.lost_count("ecg") == 0
    assert_only_gaps(h10, run.sink)


async def test_compressed_acceleration_is_the_same(sensor: MakeSensor) -> None:
    h10 = sensor(Quirks(compressed_acceleration=True))
    async with streaming(h10) as run:
        await until(run.sink.has(100, "acc"))
        assert run.sink.lost_count("acc") == 0
    assert_only_gaps(h10, run.sink)


def test_limits() -> None:
    assert session_module.GOODBYE_LIMIT_S < 0.5
