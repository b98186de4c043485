"""What each data frame puts into which stream, and what it does not."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_gateway.devices.polar_h10.driver.emitter import PolarEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement
from tests.rigs.emitter_sink import EmitterSink

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
