"""Values of the heart-rate profile, against vectors and against any bytes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.ble_heart_rate.driver.protocol import (
    HeartRateMeasurement,
    parse_battery_level,
    parse_measurement,
    parse_text,
)

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
