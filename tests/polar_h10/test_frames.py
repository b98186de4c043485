"""Data frames of the PMD service, against vectors and against any bytes."""

from __future__ import annotations

import json
import random
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import (
    Acceleration,
    Ecg,
    Frame,
    Header,
    MagneticField,
    Ppg,
    PulseIntervals,
    Rejected,
    Rotation,
    expand,
    measurement_of,
    parse_frame,
)

_FOLDER = Path(__file__).parent / "vectors"
VECTORS: list[dict[str, Any]] = [
    vector
    for name in ("polar_pmd_h10.json", "polar_pmd_verity.json")
    for vector in json.loads((_FOLDER / name).read_text(encoding="utf-8"))
    if vector["kind"] == "data"
]
Samples = list[list[int]]


def header(measurement: int, frame_type: int) -> bytes:
    return struct.pack("<BQB", measurement, 10**9, frame_type)


def lists(samples: tuple[tuple[int, ...], ...]) -> Samples:
    return [list(sample) for sample in samples]


def as_in_vectors(frame: Frame) -> dict[str, Any]:
    match frame:
        case Ecg():
            return {"uv": list(frame.microvolts)}
        case Acceleration():
            to_mg = 1000 * frame.g_per_count
            # Cut off to whole mg, as Polar's SDK does.
            in_mg = [[int(count * to_mg) for count in sample] for sample in frame.counts]
            return {"mg": in_mg, "raw": lists(frame.counts)}
        case Ppg() | Rotation() | MagneticField():
            return {"ppg": lists(frame.counts)}
        case PulseIntervals():
            return {
                "ppi": [
                    {
                        "hr": each.bpm,
                        "pp_ms": each.interval_ms,
                        "err_ms": each.error_ms,
                        "blocker": int(each.moved),
                        "contact": int(each.contact or False),
                        "contact_supported": int(each.contact is not None),
                    }
                    for each in frame.intervals
                ]
            }


def samples_of(frame: Frame) -> list[Any]:
    return list(as_in_vectors(frame).values())[-1]


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_vector(vector: dict[str, Any]) -> None:
    data, expected = bytes.fromhex(vector["hex"]), vector["expected"]
    frame = parse_frame(data, {expected["type"]: vector["factor"]})
    assert not isinstance(frame, Rejected)
    compressed = 0x80 if expected["compressed"] else 0
    assert frame.header == Header(
        expected["type"], expected["timestamp_ns"], expected["frame_type"] | compressed
    )
    values = as_in_vectors(frame)
    assert values.keys() & expected.keys()
    for name, samples in values.items():
        assert samples == expected.get(name, samples)
    assert measurement_of(data) == expected["type"]


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_a_frame_that_is_cut_anywhere_is_dropped_or_ends_with_a_sample(
    vector: dict[str, Any],
) -> None:
    data = bytes.fromhex(vector["hex"])
    whole = parse_frame(data, {})
    assert not isinstance(whole, Rejected)
    samples = samples_of(whole)
    for length in range(len(data)):
        cut = parse_frame(data[:length], {})
        if not isinstance(cut, Rejected):
            fewer = samples_of(cut)
            assert len(fewer) < len(samples)
            assert fewer == samples[: len(fewer)]


@pytest.mark.parametrize(
    ("measurement", "frame_type"),
    [(Measurement.ECG, 1), (Measurement.ECG, 0x80), (Measurement.ACCELERATION, 3), (5, 0x82)],
)
def test_an_unknown_layout_is_told_from_damage(measurement: int, frame_type: int) -> None:
    assert parse_frame(header(measurement, frame_type) + bytes(12), {}) is Rejected.UNKNOWN


@pytest.mark.parametrize("text", ["", "00", "000000000000000000"])
def test_a_frame_without_a_header_is_damaged(text: str) -> None:
    assert parse_frame(bytes.fromhex(text), {}) is Rejected.DAMAGED


def test_the_two_highest_bits_of_the_type_are_others() -> None:
    frame = parse_frame(header(0xC0, 0) + bytes(3), {})
    assert isinstance(frame, Ecg)
    assert measurement_of(b"\xc2") == Measurement.ACCELERATION
    assert measurement_of(b"") is None


@pytest.mark.parametrize(
    ("flags", "valid", "contact"),
    [(0, True, None), (1, False, None), (2, True, None), (4, False, False), (6, True, True)],
)
def test_an_interval_is_valid_without_movement_and_with_contact(
    flags: int, valid: bool, contact: bool | None
) -> None:
    sample = struct.pack("<BHHB", 60, 1000, 5, flags)
    frame = parse_frame(header(Measurement.PULSE_INTERVALS, 0) + sample, {})
    assert isinstance(frame, PulseIntervals)
    (interval,) = frame.intervals
    assert (interval.is_valid, interval.contact) == (valid, contact)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("f1ff1400f003 0601 7b0f08", [(-15, 20, 1008), (-20, 17, 1008)]),
        ("d0ff6501e40f 0801 fc07ff", [(-48, 357, 4068), (-52, 364, 4067)]),
        ("010002000300 0002", [(1, 2, 3)] * 3),
    ],
)
def test_compressed_samples(text: str, expected: Samples) -> None:
    assert expand(bytes.fromhex(text), 3, 16) == expected


def test_differences_wider_than_any_value_are_damage() -> None:
    assert expand(bytes(6) + bytes([33, 1]) + bytes(64), 3, 16) is None


def packed(samples: list[tuple[int, ...]], bits: int) -> bytes:
    """Compress as the layout says: independently, with a string of bits."""
    first, *rest = samples
    data = b"".join(value.to_bytes(2, "little", signed=True) for value in first)
    for begin in range(0, len(rest), 255):
        block = rest[begin : begin + 255]
        before = samples[begin : begin + len(block)]
        deltas = [b - a for old, new in zip(before, block, strict=True)
                  for a, b in zip(old, new, strict=True)]  # fmt: skip
        stream = "".join(format(delta % (1 << bits), f"0{bits}b")[::-1] for delta in deltas)
        stream = stream.ljust(-(-len(stream) // 8) * 8, "0")
        data += bytes([bits, len(block)])
        data += bytes(int(stream[at : at + 8][::-1], 2) for at in range(0, len(stream), 8))
    return data


@given(st.integers(0, 2**32), st.integers(1, 300), st.integers(2, 17))
def test_what_was_compressed_comes_back(seed: int, count: int, bits: int) -> None:
    rng, limit = random.Random(seed), (1 << (bits - 1)) - 1
    samples: list[tuple[int, ...]] = [(0, -5, 1000)]
    for _ in range(count):
        steps = [rng.randint(-limit, limit) for _ in range(3)]
        samples.append(tuple(a + step for a, step in zip(samples[-1], steps, strict=True)))
    assert expand(packed(samples, bits), 3, 16) == samples


@given(
    st.sampled_from([*Measurement, 4, 63]),
    st.sampled_from([0, 1, 2, 3, 0x80, 0x81, 0x8D, 0xFF]),
    st.binary(max_size=512),
    st.floats(allow_nan=False, allow_infinity=False, width=32),
)
def test_any_bytes_are_a_bounded_frame_or_rejected(
    measurement: int, frame_type: int, data: bytes, factor: float
) -> None:
    frame = parse_frame(header(measurement, frame_type) + data, {measurement: factor})
    if not isinstance(frame, Rejected):
        assert len(samples_of(frame)) <= 1 + 255 * len(data) / 2


@given(st.binary(max_size=40))
def test_any_bytes_never_raise(data: bytes) -> None:
    parse_frame(data, {})
    measurement_of(data)
