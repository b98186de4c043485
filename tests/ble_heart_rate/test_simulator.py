"""The virtual strap: what it measures and writes, heard through plain bleak."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.ble_heart_rate.simulator import SimulatedHeartRateStrap
from biosensor_gateway.devices.ble_heart_rate.simulator.services import (
    HeartRateMeasurement,
    damaged,
    encode,
)
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import BeatDetector, Pulse
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.oscillator import Oscillator
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.rigs.gatt_host import GattHost, advertised, connection
from tests.rigs.polling import until

# The virtual strap on the virtual radio, heard through plain bleak.

MEASUREMENT, LOCATION, BATTERY = "2a37", "2a38", "2a19"
NAME = "Heart Strap 0001"


@pytest.fixture
def radio(virtual_world: World) -> Iterator[Radio]:
    radio = Radio(virtual_world)
    with virtual_bluetooth(radio):
        yield radio


@pytest.fixture
def strap(radio: Radio) -> Iterator[SimulatedHeartRateStrap]:
    wearer = Wearer(heart_rate_bpm=150.0)
    with SimulatedHeartRateStrap(radio.world, radio, wearer=wearer, rssi_dbm=-66) as strap:
        yield strap


async def test_it_is_advertised_as_what_it_is(strap: SimulatedHeartRateStrap) -> None:
    device, data = await advertised(NAME)
    assert device.address == strap.settings["device"]
    assert data.service_uuids == ["0000180d-0000-1000-8000-00805f9b34fb"]
    assert data.rssi == -66


async def test_it_says_who_it_is_and_where_it_is_worn(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        read = host.client.read_gatt_char
        assert bytes(await read(LOCATION)) == b"\1"
        texts = [bytes(await read(uuid)) for uuid in ("2a29", "2a24", "2a25", "2a26")]
        assert texts == [b"Virtual Straps", b"Heart Strap", b"0001", b"1.0"]
        before_s = strap.world.clock()
        assert bytes(await read(BATTERY)) == b"\x57"
    battery, signal = strap.truth.samples("bat"), strap.truth.samples("rssi")
    assert battery.values.tolist() == [[87.0]]
    assert before_s <= battery.times[0] <= strap.world.clock()
    assert signal.values.tolist() == [[-66.0]]


async def test_nothing_is_true_that_nobody_asked_for(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        await asyncio.sleep(1.1)
        assert "hr" not in strap.truth.data_names
        assert not host.heard


async def test_a_fast_oscillator_makes_its_seconds_short(
    radio: Radio, strap: SimulatedHeartRateStrap
) -> None:
    del strap  # two on one air
    name = "Heart Strap 0002"
    with SimulatedHeartRateStrap(
        radio.world, radio, address="C8:25:00:00:00:02", name=name, jitter_s=0.05, seed=5
    ) as other:
        other.apply(Fault(FaultKind.DRIFT, 20_000.0))
        async with connection(name) as host:
            await _hear_rates(host, 4)
        times = other.truth.samples("hr").times
    np.testing.assert_allclose(np.diff(times), 1 / 1.02, atol=1e-6)


async def _hear_rates(host: GattHost, count: int) -> None:
    await host.subscribe(MEASUREMENT)
    await until(lambda: sum(bool(data[1]) for data in host.all(MEASUREMENT)) >= count)


# What a virtual strap measures and writes, without its radio.
VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/ble_heart_rate.json").read_text()
)
ORIGIN_S = 1000.0


def shortest_for(flags: int) -> int:
    """Bytes that a value with these flags has at least."""
    return 2 + (flags & 1) + 2 * (flags >> 3 & 1)


# No device means to write an odd tail, or whether it is worn and that it cannot tell.
NOT_WRITTEN = {"rr_odd_trailing_byte", "opentracks_u8"}


@pytest.mark.parametrize(
    "vector",
    [vector for vector in VECTORS if vector["name"] not in NOT_WRITTEN],
    ids=lambda vector: vector["name"],
)
def test_it_writes_the_vectors(vector: dict[str, Any]) -> None:
    data, expected = bytes.fromhex(vector["hex"]), vector["expected"]
    written = encode(
        HeartRateMeasurement(
            expected["bpm"],
            expected["rr_1024"] if data[0] & 0x10 else None,
            expected["contact"],
            expected["energy_kj"],
        ),
        wide=bool(data[0] & 1),
    )
    assert written == data


@given(st.integers(0, 0xFFFF))
def test_a_rate_takes_two_bytes_only_where_it_must(bpm: int) -> None:
    data = encode(HeartRateMeasurement(bpm))
    assert int.from_bytes(data[1:], "little") == bpm
    assert len(data) == shortest_for(data[0]) == (2 if bpm < 256 else 3)


@given(st.integers(0, 40))
def test_every_damaged_value_is_too_short_for_its_flags(count: int) -> None:
    values = list(damaged(count))
    assert len(values) == count
    assert all(not value or len(value) < shortest_for(value[0]) for value in values)


def detector(wearer: Wearer, drift_ppm: float = 0.0) -> BeatDetector:
    return BeatDetector(wearer, Oscillator(LSL_CLOCK, drift_ppm, ORIGIN_S), ORIGIN_S, ORIGIN_S)


@pytest.mark.parametrize("step_s", [0.3, 1.0, 7.0])
def test_intervals_are_those_of_the_wearer_however_often_it_looks(step_s: float) -> None:
    wearer = Wearer(heart_rate_bpm=95.0)
    heart = detector(wearer)
    found = [
        interval
        for until_s in np.arange(step_s, 60.0, step_s)
        for interval in heart.search(ORIGIN_S + float(until_s))
    ]
    beats = wearer.beats_between(0.0, 60.0)[: len(found) + 1]
    assert len(found) > 80
    np.testing.assert_allclose([one.time - ORIGIN_S for one in found], beats[1:], atol=1e-9)
    np.testing.assert_allclose([one.rr / 1024 for one in found], np.diff(beats), atol=1 / 1024)
    # The rounding does not add up.
    assert sum(one.rr for one in found) / 1024 == pytest.approx(beats[-1] - beats[0], abs=1 / 1024)


def test_intervals_are_measured_with_the_oscillator() -> None:
    wearer = Wearer()
    found = detector(wearer, drift_ppm=200.0).search(ORIGIN_S + 600.0)
    beats = wearer.beats_between(0.0, 600.0)
    fast_s = sum(one.rr for one in found) / 1024 - (beats[-1] - beats[0])
    assert fast_s == pytest.approx(600 * 200e-6, abs=0.01)


def test_the_rate_is_shown_once_there_is_an_interval_and_not_without_contact() -> None:
    wearer = Wearer(heart_rate_bpm=60.0)
    heart = detector(wearer)
    heart.search(ORIGIN_S + 0.5)
    assert heart.bpm == 0
    heart.search(ORIGIN_S + 5.0)
    assert heart.bpm == pytest.approx(60, abs=4)
    heart.lose(ORIGIN_S + 8.0)
    assert heart.bpm == 0
    first_ends = heart.search(ORIGIN_S + 12.0)[0].time - ORIGIN_S
    assert first_ends == pytest.approx(wearer.beats_between(8.0, 12.0)[1])


def test_only_what_was_sent_is_the_truth() -> None:
    truth = Truth()
    pulse = Pulse(detector(Wearer()), tells_contact=True, sends_rr=True)
    worn = pulse.measure(ORIGIN_S + 3.0, worn=True)
    pulse.note(truth, ORIGIN_S + 3.0, sent=True)
    lost = pulse.measure(ORIGIN_S + 6.0, worn=True)
    pulse.note(truth, ORIGIN_S + 6.0, sent=False)
    off = pulse.measure(ORIGIN_S + 7.0, worn=False)
    pulse.note(truth, ORIGIN_S + 7.0, sent=True)

    assert worn.rr is not None
    assert lost.rr is not None
    assert off == HeartRateMeasurement(0, (), contact=False)
    assert truth.samples("hr").values.tolist() == [[float(worn.bpm)]]
    np.testing.assert_array_equal(truth.samples("ibi").values[:, 0] * 1024, worn.rr)
    assert truth.samples("quality").values.tolist() == [[1.0], [0.0]]
    unsent = [truth.unsent_count(name) for name in ("hr", "ibi", "quality")]
    assert unsent == [1, len(lost.rr), 1]
