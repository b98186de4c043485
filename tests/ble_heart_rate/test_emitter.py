"""Values of the heart-rate profile: against vectors and any bytes, and into which streams."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.ble_heart_rate.driver.protocol import (
    HeartRateMeasurement,
    parse_battery_level,
    parse_measurement,
    parse_text,
)
from tests.rigs.emitter_sink import EmitterSink

# What each value of a strap puts into which stream, and what it does not.

ARRIVAL_S = 5_000.0


@pytest.fixture
def sink() -> EmitterSink:
    return EmitterSink("ble_heart_rate")


@pytest.fixture
def emitter(sink: EmitterSink) -> StrapEmitter:
    return StrapEmitter(sink)


def firsts(sink: EmitterSink) -> dict[str, list[float]]:
    return {name: sink.values(name) for name in sink.emitted}


def test_a_measurement_fills_rate_intervals_and_quality(
    emitter: StrapEmitter, sink: EmitterSink
) -> None:
    emitter.measurement(bytes.fromhex("108e9d01a801"), ARRIVAL_S)
    emitter.measurement(bytes.fromhex("008e"), ARRIVAL_S + 1)
    assert firsts(sink) == {"hr": [142] * 2, "ibi": [413 / 1024, 424 / 1024], "quality": [1] * 2}
    assert sink.times["hr"] == sink.times["quality"] == [ARRIVAL_S, ARRIVAL_S + 1]
    assert sink.times["ibi"] == [ARRIVAL_S - 424 / 1024, ARRIVAL_S]
    assert (sink.heard_count, sink.dropped_bytes) == (2, 0)


def test_beats_keep_their_distances_although_packets_jitter(
    emitter: StrapEmitter, sink: EmitterSink
) -> None:
    for packet, late in enumerate([0.0, 0.08, 0.03, 0.1]):
        emitter.measurement(bytes.fromhex("103c0004"), ARRIVAL_S + packet + late)
    assert np.diff(sink.times["ibi"]) == pytest.approx([1.0] * 3, abs=0.01)


def test_no_rate_and_no_interval_send_nothing(emitter: StrapEmitter, sink: EmitterSink) -> None:
    emitter.measurement(bytes.fromhex("10000000"), ARRIVAL_S)
    assert firsts(sink) == {"quality": [0]}


def test_an_interval_of_unknown_length_is_not_sent_and_moves_no_beat(
    emitter: StrapEmitter, sink: EmitterSink
) -> None:
    emitter.measurement(bytes.fromhex("103c0004"), ARRIVAL_S)
    emitter.measurement(bytes.fromhex("103cffff"), ARRIVAL_S + 1)
    emitter.measurement(bytes.fromhex("103c0004ffff0002"), ARRIVAL_S + 2)
    emitter.measurement(bytes.fromhex("103c0002"), ARRIVAL_S + 2.5)
    assert sink.values("ibi") == [1.0, 0.5, 0.5]
    assert sink.times["ibi"] == pytest.approx([ARRIVAL_S, ARRIVAL_S + 2, ARRIVAL_S + 2.5], abs=0.01)


@pytest.mark.parametrize(("flags", "contact"), [(0x16, 1), (0x14, 0)])
def test_contact_is_what_the_strap_tells(
    emitter: StrapEmitter, sink: EmitterSink, flags: int, contact: float
) -> None:
    emitter.measurement(bytes([flags, 60, 0, 4]), ARRIVAL_S)
    assert sink.values("quality") == [contact]
    # Quality filters nothing.
    assert sink.values("hr") == [60]


def test_contact_is_inferred_from_missing_intervals(
    emitter: StrapEmitter, sink: EmitterSink
) -> None:
    emitter.measurement(bytes.fromhex("103c0004"), ARRIVAL_S)
    for second in range(1, 9):
        emitter.measurement(bytes.fromhex("103c"), ARRIVAL_S + second)
    emitter.measurement(bytes.fromhex("103c0004"), ARRIVAL_S + 9)
    assert sink.values("quality") == [1] * 6 + [0] * 3 + [1]


def test_a_strap_without_intervals_may_be_worn(emitter: StrapEmitter, sink: EmitterSink) -> None:
    for second in range(9):
        emitter.measurement(bytes.fromhex("003c"), ARRIVAL_S + second)
    assert sink.values("quality") == [1] * 9


def test_a_connection_starts_without_a_past(emitter: StrapEmitter, sink: EmitterSink) -> None:
    emitter.measurement(bytes.fromhex("103c0004"), ARRIVAL_S)
    emitter.reconnected()
    emitter.measurement(bytes.fromhex("103c"), ARRIVAL_S + 60)
    emitter.measurement(bytes.fromhex("103c00040004"), ARRIVAL_S + 61)
    assert sink.values("quality") == [1, 1, 1]
    assert sink.times["ibi"] == [ARRIVAL_S, ARRIVAL_S + 60, ARRIVAL_S + 61]


def test_intervals_that_come_better_elsewhere_are_passed_over(
    emitter: StrapEmitter, sink: EmitterSink
) -> None:
    emitter.has_better_intervals = True
    emitter.measurement(bytes.fromhex("103c0004"), ARRIVAL_S)
    assert sink.emitted.keys() == {"hr", "quality"}


def test_battery_and_signal_strength(emitter: StrapEmitter, sink: EmitterSink) -> None:
    emitter.battery(b"\x57", ARRIVAL_S)
    emitter.battery(b"\xff", ARRIVAL_S + 1)
    emitter.signal_strength(-61, ARRIVAL_S)
    emitter.signal_strength(None, ARRIVAL_S + 1)
    assert firsts(sink) == {"bat": [87], "rssi": [-61]}


def test_what_is_cut_short_is_counted(emitter: StrapEmitter, sink: EmitterSink) -> None:
    emitter.measurement(b"\x01\x48", ARRIVAL_S)
    assert (sink.emitted, sink.dropped_bytes, sink.heard_count) == ({}, 2, 0)


@given(st.lists(st.binary(max_size=40), max_size=20))
def test_any_values_are_emitted_or_counted(values: list[bytes]) -> None:
    sink = EmitterSink("ble_heart_rate")
    emitter = StrapEmitter(sink)
    for second, data in enumerate(values):
        emitter.measurement(data, ARRIVAL_S + second)
        emitter.battery(data, ARRIVAL_S + second)
    assert sink.heard_count == len(sink.values("quality"))
    dropped = len(values) - sink.heard_count
    assert dropped <= sum(len(data) < 5 for data in values)
    assert sink.dropped_bytes <= 4 * dropped
    assert not any(np.isnan(rows).any() for rows in sink.emitted.values())


# Values of the heart-rate profile, against vectors and against any bytes.
VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors" / "ble_heart_rate.json").read_text(encoding="utf-8")
)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_vector(vector: dict[str, Any]) -> None:
    measured = parse_measurement(bytes.fromhex(vector["hex"]))
    assert measured is not None
    expected = vector["expected"]
    assert measured.bpm == expected["bpm"]
    assert measured.contact == expected["contact"]
    assert (measured.contact is not None) == expected["contact_supported"]
    assert measured.energy_kj == expected["energy_kj"]
    assert list(measured.intervals) == expected["rr_1024"]
    in_ms = [seconds * 1000 for seconds in measured.intervals_s]
    assert in_ms == pytest.approx(expected["rr_ms"], abs=1e-3)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("018080", HeartRateMeasurement(0x8080, None, None, ())),
        ("0600", HeartRateMeasurement(0, True, None, ())),
        ("0400", HeartRateMeasurement(0, False, None, ())),
        ("0200", HeartRateMeasurement(0, None, None, ())),
        ("08007f80", HeartRateMeasurement(0, None, 32895, ())),
        ("110000ffff7f80", HeartRateMeasurement(0, None, None, (65535, 32895))),
        # Without their flag, bytes behind the rate are no intervals.
        ("003cff03", HeartRateMeasurement(60, None, None, ())),
        ("e03c", HeartRateMeasurement(60, None, None, ())),
    ],
)
def test_layout(text: str, expected: HeartRateMeasurement) -> None:
    assert parse_measurement(bytes.fromhex(text)) == expected


@pytest.mark.parametrize("text", ["", "00", "0148", "083c", "083c01", "0d2c0101"])
def test_a_measurement_that_is_cut_short_is_none(text: str) -> None:
    assert parse_measurement(bytes.fromhex(text)) is None


@given(st.binary(max_size=512))
def test_any_bytes_are_a_bounded_measurement_or_none(data: bytes) -> None:
    measured = parse_measurement(data)
    if measured is None:
        assert len(data) < 5
    else:
        assert 0 <= measured.bpm <= 0xFFFF
        assert len(measured.intervals) <= len(data) // 2
        assert all(0 <= interval <= 0xFFFF for interval in measured.intervals)


@pytest.mark.parametrize(
    ("data", "percent"), [(b"\x00", 0), (b"\x64", 100), (b"\x65", None), (b"", None)]
)
def test_battery_level(data: bytes, percent: int | None) -> None:
    assert parse_battery_level(data) == percent


@given(st.binary(max_size=512))
def test_a_text_can_always_be_printed(data: bytes) -> None:
    text = parse_text(data)
    assert text.isprintable()
    assert text == text.strip()


def test_a_text_ends_before_its_nul() -> None:
    assert parse_text(b"5.0.0\x00") == "5.0.0"
