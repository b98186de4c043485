"""What each data frame puts into which stream, when it was measured, and what is missing."""

from __future__ import annotations

import json
import random
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_common.refusal import Refusal
from biosensor_gateway.devices.polar_h10.driver.emitter import FrameTimeline, Placed, PolarEmitter
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
from tests.rigs.emitter_sink import EmitterSink

# What each data frame puts into which stream, and what it does not.

START_NS = 599_616_000_000_000_000
START_S = START_NS / 1e9
ARRIVAL_S = 5_000.0
COUNT = 73
ECG_PERIOD_NS = 1e9 / 130
ECG, ACC = Measurement.ECG, Measurement.ACCELERATION


@pytest.fixture
def sink() -> EmitterSink:
    return EmitterSink("polar_h10")


@pytest.fixture
def emitter(sink: EmitterSink) -> PolarEmitter:
    emitter = PolarEmitter(sink)
    emitter.started(ECG, 130, 1.0)
    emitter.started(ACC, 50, 1.0)
    return emitter


def ecg(number: int, count: int = COUNT) -> bytes:
    """Return frame `number` since the start, full of its number."""
    stamp = START_NS + round((number + 1) * COUNT * ECG_PERIOD_NS)
    return struct.pack("<BQB", ECG, stamp, 0) + number.to_bytes(3, "little", signed=True) * count


def arrival(number: int) -> float:
    return ARRIVAL_S + (number + 1) * COUNT * ECG_PERIOD_NS / 1e9


def test_ecg_stays_microvolts_on_the_device_s_clock(
    emitter: PolarEmitter, sink: EmitterSink
) -> None:
    emitter.frame(ecg(0), arrival(0))
    emitter.frame(ecg(1), arrival(1))
    assert sink.emitted == {"ecg": [[0]] * COUNT + [[1]] * COUNT}
    expected = [START_S + (k + 1) / 130 for k in range(2 * COUNT)]
    assert sink.device_times["ecg"] == pytest.approx(expected, abs=1e-6)
    # The clock is told when the last sample was measured, and when that arrived.
    last = sink.device_times["ecg"][COUNT - 1], sink.device_times["ecg"][-1]
    assert sink.observed == list(zip(last, (arrival(0), arrival(1)), strict=True))
    assert (sink.losses, sink.heard_count) == ({}, 2)


def test_acceleration_becomes_g(emitter: PolarEmitter, sink: EmitterSink) -> None:
    samples = struct.pack("<6h", -9, -1, 999, 32767, -32768, 0)
    emitter.frame(struct.pack("<BQB", ACC, START_NS, 1) + samples, ARRIVAL_S)
    np.testing.assert_allclose(
        sink.emitted["acc"], [[-0.009, -0.001, 0.999], [32.767, -32.768, 0]], rtol=1e-9
    )
    assert np.diff(sink.device_times["acc"]) == pytest.approx([0.02], abs=1e-6)


def test_compressed_acceleration_is_scaled_as_the_device_said(
    emitter: PolarEmitter, sink: EmitterSink
) -> None:
    emitter.started(ACC, 52, 0.000244)
    reference = struct.pack("<3h", -48, 357, 4068)
    emitter.frame(struct.pack("<BQB", ACC, START_NS, 0x80) + reference, ARRIVAL_S)
    np.testing.assert_allclose(sink.emitted["acc"], [[-0.011712, 0.087108, 0.992592]], rtol=1e-9)
    assert emitter.rates == {"ecg": 130, "acc": 52}


def test_lost_frames_are_counted_in_samples_and_said(
    emitter: PolarEmitter, sink: EmitterSink
) -> None:
    emitter.frame(ecg(0), arrival(0))
    with capture_logs() as logs:
        emitter.frame(ecg(4), arrival(4))
    assert sink.losses == {"ecg": 3 * COUNT}
    assert [(each["data"], each["count"], each["estimated"]) for each in logs] == [
        ("ecg", 3 * COUNT, True)
    ]


def test_a_reconnection_is_a_gap_of_known_length(emitter: PolarEmitter, sink: EmitterSink) -> None:
    emitter.frame(ecg(0), arrival(0))
    emitter.reconnected()
    emitter.started(ECG, 130, 1.0)
    emitter.frame(ecg(10), arrival(10))
    assert sink.losses == {"ecg": 9 * COUNT}
    assert len(sink.emitted["ecg"]) == 2 * COUNT


@pytest.mark.parametrize("off_s", [0.5, 3.0, 3600.0])
def test_a_device_that_was_off_counts_again(
    emitter: PolarEmitter, sink: EmitterSink, off_s: float
) -> None:
    for number in range(4):
        emitter.frame(ecg(number), arrival(number))
    emitter.reconnected()
    emitter.started(ECG, 130, 1.0)
    emitter.frame(ecg(0), arrival(4) + off_s)
    emitter.frame(ecg(1), arrival(5) + off_s)
    assert len(sink.restarts) == 1
    assert sink.losses == {}


def test_a_device_that_stayed_on_goes_on_counting(emitter: PolarEmitter, sink: EmitterSink) -> None:
    emitter.frame(ecg(0), arrival(0))
    emitter.reconnected()
    # An hour, in which the device's clock loses half a second.
    emitter.frame(ecg(6400), arrival(6400) + 0.5)
    assert sink.restarts == []


def test_a_frame_without_samples_says_nothing(emitter: PolarEmitter, sink: EmitterSink) -> None:
    emitter.frame(ecg(0, 0), arrival(0))
    emitter.frame(ecg(1), arrival(1))
    assert len(sink.emitted["ecg"]) == COUNT
    assert sink.dropped_bytes == 0


@pytest.mark.parametrize(
    ("data", "cause"),
    [(ecg(0)[:-1], "damaged"), (ecg(0)[:9], "damaged"), (b"\x00" * 9 + b"\x03abc", "unknown")],
)
def test_a_frame_that_makes_no_sense_is_dropped_and_counted(
    emitter: PolarEmitter, sink: EmitterSink, data: bytes, cause: str
) -> None:
    with capture_logs() as logs:
        emitter.frame(data, ARRIVAL_S)
        emitter.frame(data, ARRIVAL_S)
    assert (sink.emitted, sink.observed, sink.heard_count) == ({}, [], 0)
    assert sink.dropped_bytes == 2 * len(data)
    assert [each["cause"] for each in logs] == [cause]


def test_a_dropped_frame_is_a_loss_once_the_next_one_comes(
    emitter: PolarEmitter, sink: EmitterSink
) -> None:
    emitter.frame(ecg(0), arrival(0))
    emitter.frame(ecg(1)[:-1], arrival(1))
    emitter.frame(ecg(2), arrival(2))
    assert sink.losses == {"ecg": COUNT}


def test_a_clock_that_stands_still_is_said_once(emitter: PolarEmitter, sink: EmitterSink) -> None:
    with capture_logs() as logs:
        for number in range(3):
            emitter.frame(ecg(0)[:10] + bytes([number, 0, 0]) * COUNT, arrival(number))
    assert len(logs) == 1
    assert len(sink.emitted["ecg"]) == 3 * COUNT


def test_what_was_not_started_is_not_emitted(sink: EmitterSink) -> None:
    emitter = PolarEmitter(sink)
    emitter.frame(ecg(0), ARRIVAL_S)
    emitter.frame(struct.pack("<BQB", Measurement.PPG, START_NS, 0) + bytes(12), ARRIVAL_S)
    assert (sink.emitted, sink.dropped_bytes) == ({}, 0)


@given(st.lists(st.tuples(st.sampled_from([0, 1, 2, 3, 9]), st.binary(max_size=60)), max_size=10))
def test_any_frames_are_emitted_or_counted(frames: list[tuple[int, bytes]]) -> None:
    sink = EmitterSink("polar_h10")
    emitter = PolarEmitter(sink)
    for measurement in Measurement:
        emitter.started(measurement, 50, 1.0)
    for second, (measurement, data) in enumerate(frames):
        frame = bytes([measurement]) + data
        before = sink.dropped_bytes
        emitter.frame(frame, ARRIVAL_S + second)
        assert sink.dropped_bytes - before in {0, len(frame)}


# Frames that come twice or in another order, as reported in polar-ble-sdk #387.
def taken(sink: EmitterSink, *numbers: int) -> list[int]:
    """Take frames in, each as soon as the newest is complete; return whose samples were emitted."""
    emitter, newest = PolarEmitter(sink), 0
    emitter.started(ECG, 130, 1.0)
    for number in numbers:
        newest = max(newest, number)
        emitter.frame(ecg(number), arrival(newest))
    return [int(value) for value in sink.values("ecg")[::COUNT]]


def test_a_copy_is_left_out_and_said(sink: EmitterSink) -> None:
    assert taken(sink, 0, 1, 1, 2, 0, 3) == [0, 1, 2, 3]
    expected = [START_S + (k + 1) / 130 for k in range(4 * COUNT)]
    assert sink.device_times["ecg"] == pytest.approx(expected, abs=1e-6)
    assert (sink.losses, sink.refusals.count(Refusal.LEFT_OUT)) == ({}, 2 * COUNT)
    assert sink.refusals.all[0].sentence == f"{2 * COUNT} samples were left out: they came twice"


def test_what_comes_behind_a_later_one_is_lost_once_and_no_stamp_goes_back(
    sink: EmitterSink,
) -> None:
    assert taken(sink, 0, 2, 1, 3, 4) == [0, 2, 3, 4]
    times = sink.device_times["ecg"]
    assert times == sorted(times)
    assert sink.losses == {"ecg": COUNT}
    assert sink.refusals.count(Refusal.LEFT_OUT) == COUNT


def test_a_clock_that_was_set_back_goes_on_with_its_second_frame(sink: EmitterSink) -> None:
    assert taken(sink, 5, 6, 1, 2, 3, 4) == [5, 6, 2, 3, 4]
    assert sink.refusals.count(Refusal.LEFT_OUT) == COUNT


# When samples were measured, and how many are missing, by the stamps of their frames.
_FOLDER = Path(__file__).parent / "vectors"
(VECTOR,) = [
    vector["expected"]
    for vector in json.loads((_FOLDER / "polar_pmd_h10.json").read_text(encoding="utf-8"))
    if vector["kind"] == "timestamps"
]


class Device:
    """Measures at a true rate, and stamps every frame at its last sample."""

    def __init__(self, rate_hz: float = 130.0) -> None:
        self.period_ns = 1e9 / rate_hz
        self.measured = 0
        self.timeline = FrameTimeline(130.0)

    def skip(self, count: int) -> None:
        self.measured += count

    def true_times(self, count: int) -> list[int]:
        return [
            START_NS + round((self.measured + index + 1) * self.period_ns) for index in range(count)
        ]

    def frame(self, count: int = COUNT) -> Placed:
        """Measure a frame and place it, as soon as it is complete."""
        times = self.true_times(count)
        self.measured += count
        return self.timeline.place(times[-1], count, (times[-1] - START_NS) / 1e9)


def worst(placed: Placed, expected: list[int]) -> int:
    """Largest error in ns; whole numbers, which are too long for a float."""
    return max(abs(a - b) for a, b in zip(placed.times_ns, expected, strict=True))


def test_vector_of_the_first_frame() -> None:
    expected: dict[str, Any] = VECTOR
    timeline = FrameTimeline(expected["nominal_hz"])
    placed = timeline.place(expected["frame_ns"], expected["n"], 0.0)
    # The vector's times were computed in floating point, to 64 ns.
    assert worst(placed, expected["sample_ns"]) <= 128
    assert placed.times_ns[-1] == expected["frame_ns"]
    assert (placed.lost, placed.steps_back) == (0, False)


@pytest.mark.parametrize("rate_hz", [127.4, 130.0, 132.6])
def test_the_true_rate_comes_from_the_stamps(rate_hz: float) -> None:
    device = Device(rate_hz)
    device.frame()
    for _ in range(20):
        expected = device.true_times(COUNT)
        placed = device.frame()
        assert worst(placed, expected) <= 2
        assert placed.lost == 0


@pytest.mark.parametrize("rate_hz", [127.4, 130.0, 132.6])
@pytest.mark.parametrize("frames", [1, 2, 10, 100])
def test_lost_frames_are_counted_in_samples(rate_hz: float, frames: int) -> None:
    device = Device(rate_hz)
    for _ in range(5):
        device.frame()
    device.skip(frames * COUNT)
    expected = device.true_times(COUNT)
    placed = device.frame()
    assert placed.lost == frames * COUNT
    # Not stretched over the gap.
    assert worst(placed, expected) <= 100
    assert device.frame().lost == 0


def test_frames_of_one_sample_lose_single_samples() -> None:
    device = Device()
    assert [device.frame(1).lost for _ in range(10)] == [0] * 10
    device.skip(1)
    assert device.frame(1).lost == 1


def test_a_restart_is_a_gap_of_known_length() -> None:
    device = Device(131.0)
    for _ in range(50):
        device.frame()
    device.timeline.restart(130.0)
    device.skip(1310)
    expected = device.true_times(COUNT)
    placed = device.frame()
    assert placed.lost == 1310
    # The rate is known from before.
    assert worst(placed, expected) <= 1000


def test_another_rate_forgets_the_old_one() -> None:
    timeline = FrameTimeline(50.0)
    timeline.place(START_NS, 36, 0.0)
    timeline.place(START_NS + 720_000_000, 36, 0.72)
    timeline.restart(25.0)
    placed = timeline.place(START_NS + 2_160_000_000, 36, 2.16)
    assert np.diff(placed.times_ns) == pytest.approx([40_000_000] * 35)
    assert placed.lost == 0


def test_a_device_that_was_off_measured_nothing() -> None:
    device = Device()
    device.frame()
    device.timeline.restart(130.0)
    placed = device.timeline.place(START_NS + 10**9, COUNT, 300.0)
    assert placed.lost == 0


def test_a_clock_that_is_set_loses_nothing() -> None:
    device = Device()
    device.frame()
    year_ns = 365 * 86_400 * 10**9
    placed = device.timeline.place(START_NS + year_ns, COUNT, 1.1)
    assert (placed.lost, placed.steps_back) == (0, False)
    assert np.diff(placed.times_ns) == pytest.approx([1e9 / 130] * (COUNT - 1), abs=1)


@pytest.mark.parametrize("back_ns", [0, 10**9])
def test_a_clock_that_does_not_advance_falls_back_to_the_nominal_rate(back_ns: int) -> None:
    timeline = FrameTimeline(130.0)
    timeline.place(START_NS, COUNT, 0.0)
    placed = timeline.place(START_NS - back_ns, COUNT, 0.56)
    assert (placed.lost, placed.steps_back) == (0, True)
    assert placed.times_ns[-1] == START_NS - back_ns
    assert np.diff(placed.times_ns) == pytest.approx([1e9 / 130] * (COUNT - 1), abs=1)


@given(
    st.lists(
        st.tuples(st.integers(0, 2**64 - 1), st.integers(1, 300), st.floats(0, 1e6), st.booleans()),
        max_size=30,
    )
)
def test_any_stamps_give_ascending_times_and_no_negative_loss(
    frames: list[tuple[int, int, float, bool]],
) -> None:
    timeline, arrival = FrameTimeline(130.0), 0.0
    for timestamp, count, pause, restarts in frames:
        arrival += pause
        if restarts:
            timeline.restart(130.0)
        placed = timeline.place(timestamp, count, arrival)
        assert len(placed.times_ns) == count
        assert placed.times_ns[-1] == timestamp
        assert all(a <= b for a, b in pairwise(placed.times_ns))
        assert 0 <= placed.lost < 200 * (pause + 10) + 1e6 * 200


# Data frames of the PMD service, against vectors and against any bytes.

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
