"""The virtual strap: what it measures and writes, heard through plain bleak."""

from __future__ import annotations

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
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import BeatDetector
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import Oscillator, World
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.rigs.gatt_host import advertised

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
