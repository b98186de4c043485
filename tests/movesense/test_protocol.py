"""Messages and payloads, against vectors and against any bytes."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.movesense.driver import protocol
from biosensor_gateway.devices.movesense.driver.protocol import (
    Kind,
    Message,
    parse_ecg,
    parse_heart_rate,
    parse_message,
    parse_temperature,
    parse_vectors,
)

VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/movesense_gsp.json").read_text(encoding="utf-8")
)


def of_kind(*kinds: str) -> pytest.MarkDecorator:
    found = [vector for vector in VECTORS if vector["kind"] in kinds]
    assert found
    return pytest.mark.parametrize("vector", found, ids=[vector["name"] for vector in found])


def message(vector: dict[str, Any]) -> Message:
    found = parse_message(bytes.fromhex(vector["hex"]))
    assert found is not None
    return found


@of_kind("ecg")
def test_ecg_is_in_microvolts_whatever_came(vector: dict[str, Any]) -> None:
    block = parse_ecg(message(vector).payload, vector["width"])
    expected = vector["expected"]
    if expected is None:
        assert block is None
        return
    assert block is not None
    assert block.stamp_ms == expected["stamp_ms"]
    assert block.samples.shape == (1, len(expected["microvolts"]), 1)
    np.testing.assert_allclose(block.samples.ravel(), expected["microvolts"], rtol=1e-9)


@of_kind("vectors")
def test_vectors_stand_array_behind_array(vector: dict[str, Any]) -> None:
    block = parse_vectors(message(vector).payload, vector["streams"])
    expected = vector["expected"]
    if expected is None:
        assert block is None
        return
    assert block is not None
    assert block.stamp_ms == expected["stamp_ms"]
    np.testing.assert_allclose(block.samples, expected["streams"], rtol=1e-6)


@of_kind("heart_rate")
def test_a_heart_rate_has_its_intervals(vector: dict[str, Any]) -> None:
    measured = parse_heart_rate(message(vector).payload)
    expected = vector["expected"]
    found = measured and {"bpm": measured.bpm, "intervals_ms": list(measured.intervals_ms)}
    assert found == expected


@of_kind("temperature")
def test_a_temperature_is_in_degrees_celsius(vector: dict[str, Any]) -> None:
    measured = parse_temperature(message(vector).payload)
    if vector["expected"] is None:
        assert measured is None
    else:
        expected = vector["expected"]["stamp_ms"], pytest.approx(vector["expected"]["celsius"])
        assert measured == expected


@of_kind("greeting")
def test_a_greeting_says_who_it_is(vector: dict[str, Any]) -> None:
    greeting = protocol.parse_greeting(message(vector).payload)
    assert greeting._asdict() == vector["expected"]
    assert not protocol.is_refused_greeting(message(vector).payload)


@of_kind("answer")
def test_an_answer_says_whether_it_is_a_refusal(vector: dict[str, Any]) -> None:
    found = message(vector)
    assert {"status": found.status, "is_refusal": found.is_refusal} == vector["expected"]


@of_kind("part")
def test_a_part_goes_with_a_reference(vector: dict[str, Any]) -> None:
    found = message(vector)
    assert found.kind is Kind.DATA_PART_2
    assert {"reference": found.reference, "payload": found.payload.hex()} == vector["expected"]


@of_kind("nothing")
def test_anything_else_is_no_message(vector: dict[str, Any]) -> None:
    assert parse_message(bytes.fromhex(vector["hex"])) is None


def test_a_greeting_that_is_refused_is_told_from_one_that_is_not() -> None:
    assert protocol.is_refused_greeting(struct.pack("<H", 429))
    assert not protocol.is_refused_greeting(struct.pack("<H", 200))


def test_commands_are_written_as_documented() -> None:
    assert protocol.hello(1) == b"\x00\x01"
    assert protocol.subscribe(100, "/Meas/ECG/200") == b"\x01\x64/Meas/ECG/200"
    assert protocol.unsubscribe(100) == b"\x02\x64"


@given(st.binary(max_size=200), st.sampled_from([2, 4]), st.integers(1, 3))
def test_any_bytes_are_read_whole_or_not_at_all(data: bytes, width: int, streams: int) -> None:
    ecg, vectors = parse_ecg(data, width), parse_vectors(data, streams)
    if ecg is not None:
        assert ecg.samples.size in {(len(data) - 4) / each for each in (2, 4)}
    if vectors is not None:
        assert vectors.samples.size * 4 == len(data) - 4
        assert np.isfinite(vectors.samples).all()
    measured = parse_heart_rate(data)
    assert measured is None or len(measured.intervals_ms) * 2 == len(data) - 4
    protocol.parse_greeting(data)
