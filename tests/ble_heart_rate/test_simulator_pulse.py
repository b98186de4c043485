"""What a virtual strap measures and writes, without its radio."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.ble_heart_rate.simulator.services import (
    HeartRateMeasurement,
    damaged,
    encode,
)
from biosensor_gateway.devices.ble_heart_rate.simulator.strap import BeatDetector, Pulse
from biosensor_gateway.simulation.oscillator import Oscillator
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.system.clock import LSL_CLOCK

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
