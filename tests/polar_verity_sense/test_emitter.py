"""Frames of optical sensors, against vectors, and what each puts into which stream."""

from __future__ import annotations

import json
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    Measurement,
    Reply,
    Setting,
    choose,
    parse_indication,
    parse_settings,
    start,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import (
    PulseIntervals,
    Rejected,
    parse_frame,
)
from biosensor_gateway.devices.polar_verity_sense.driver import (
    DATA_NAMES,
    OpticalEmitter,
    true_ppg_rates,
)
from tests.rigs.emitter_sink import EmitterSink

# What each data frame of an optical sensor puts into which stream, and what it does not.

START_NS = 599_616_000_000_000_000
START_S = START_NS / 1e9
ARRIVAL_S = 5_000.0
PPG, ACC, PPI = Measurement.PPG, Measurement.ACCELERATION, Measurement.PULSE_INTERVALS
COUNT = 30


@pytest.fixture
def sink() -> EmitterSink:
    return EmitterSink("polar_verity_sense")


@pytest.fixture
def emitter(sink: EmitterSink) -> OpticalEmitter:
    return OpticalEmitter(sink)


def ppi(stamp_ns: int, *samples: tuple[int, int]) -> bytes:
    """Return a frame of pairs of interval [ms] and flags."""
    values = b"".join(struct.pack("<BHHB", 60, ms, 5, flags) for ms, flags in samples)
    return struct.pack("<BQB", PPI, stamp_ns, 0) + values


def light(number: int, rate_hz: float) -> tuple[bytes, float]:
    """Return frame `number` since the start, full of its number, and when it arrives."""
    after_s = (number + 1) * COUNT / rate_hz
    body = b"".join(number.to_bytes(3, "little") for _ in range(4 * COUNT))
    return struct.pack("<BQB", PPG, START_NS + round(after_s * 1e9), 0) + body, ARRIVAL_S + after_s


def test_intervals_without_stamps_are_placed_by_their_arrival(
    emitter: OpticalEmitter, sink: EmitterSink
) -> None:
    emitter.frame(ppi(0, (800, 6), (900, 7), (1000, 4), (700, 0)), ARRIVAL_S)
    emitter.frame(ppi(0), ARRIVAL_S + 5)
    # One of a moving sensor is no interval, but takes its time; contact is not to be believed.
    assert sink.emitted == {"ppi": [[0.8, 0.005], [1.0, 0.005], [0.7, 0.005]]}
    expected = [ARRIVAL_S - 2.6, ARRIVAL_S - 0.7, ARRIVAL_S]
    assert sink.lsl_times["ppi"] == pytest.approx(expected)
    assert (sink.observed, sink.heard_count) == ([], 2)


def test_a_batch_of_several_frames_is_placed_as_one(
    emitter: OpticalEmitter, sink: EmitterSink
) -> None:
    emitter.frame(ppi(0, (800, 6), (900, 6)), ARRIVAL_S - 0.02)
    emitter.frame(ppi(0, (1000, 6), (700, 6)), ARRIVAL_S)
    emitter.strap.measurement(bytes.fromhex("063c"), ARRIVAL_S + 1)
    expected = [ARRIVAL_S - 2.6, ARRIVAL_S - 1.7, ARRIVAL_S - 0.7, ARRIVAL_S]
    assert sink.lsl_times["ppi"][:4] == pytest.approx(expected)
    assert [row[0] for row in sink.emitted["ppi"]] == [0.8, 0.9, 1.0, 0.7]


def test_intervals_with_stamps_are_placed_on_the_device_s_clock(
    emitter: OpticalEmitter, sink: EmitterSink
) -> None:
    emitter.started(PPG, 55, 1.0)
    emitter.frame(*light(0, 55))
    emitter.frame(ppi(START_NS, (800, 6), (700, 6)), ARRIVAL_S)
    assert sink.device_times["ppi"] == pytest.approx([START_S - 0.7, START_S], abs=1e-6)
    assert len(sink.observed) == 1


def test_stamped_intervals_do_not_wait_for_the_device_s_clock(
    emitter: OpticalEmitter, sink: EmitterSink
) -> None:
    emitter.started(PPG, 55, 1.0)
    emitter.frame(*light(0, 55))
    emitter.reconnected()
    emitter.frame(ppi(START_NS, (800, 6)), ARRIVAL_S)
    emitter.reconnected()
    assert sink.lsl_times["ppi"] == [ARRIVAL_S]


@pytest.mark.parametrize(("flags", "moving"), [((), None), ((6, 6), 0.0), ((6, 7), 1.0)])
def test_quality_tells_contact_and_movement_as_the_device_does(
    emitter: OpticalEmitter, sink: EmitterSink, flags: tuple[int, ...], moving: float | None
) -> None:
    emitter.frame(ppi(0, *((800, each) for each in flags)), ARRIVAL_S)
    emitter.strap.measurement(bytes.fromhex("043c"), ARRIVAL_S)
    # A heart rate without contact is sent: the bit is not to be believed.
    assert sink.emitted["hr"] == [[60]]
    ((contact, is_moving),) = sink.emitted["quality"]
    assert contact == 0
    assert np.isnan(is_moving) if moving is None else is_moving == moving


def test_light_of_two_diodes_leaves_the_others_open(
    emitter: OpticalEmitter, sink: EmitterSink
) -> None:
    emitter.started(PPG, 22, 1.0)
    reference = b"".join(value.to_bytes(3, "little") for value in (7, 9, 0))
    emitter.frame(struct.pack("<BQB", PPG, START_NS, 0x8D) + reference, ARRIVAL_S)
    np.testing.assert_array_equal(sink.emitted["ppg"], [[7, 9, np.nan, np.nan]])


@pytest.mark.parametrize(("said", "true"), [(135, 55), (55, 135), (130, 135)])
def test_a_rate_that_is_said_wrong_is_learned_and_loses_nothing(
    emitter: OpticalEmitter, sink: EmitterSink, said: float, true: float
) -> None:
    emitter.started(PPG, said, 1.0)
    for number in range(12):
        emitter.frame(*light(number, true))
    assert sink.losses == {}
    times = np.array(sink.device_times["ppg"]) - START_S
    expected = (np.arange(12 * COUNT) + 1) / true
    settled = 4 * COUNT
    np.testing.assert_allclose(times[settled:], expected[settled:], atol=1e-6)


@pytest.mark.parametrize("missing", [1, 3])
def test_a_loss_among_the_first_frames_is_counted_once_the_rate_is_certain(
    emitter: OpticalEmitter, sink: EmitterSink, missing: int
) -> None:
    emitter.started(PPG, 55, 1.0)
    emitter.frame(*light(0, 55))
    emitter.frame(*light(1 + missing, 55))
    assert sink.losses == {}
    emitter.frame(*light(2 + missing, 55))
    assert sink.losses == {"ppg": missing * COUNT}


def test_a_loss_after_the_rate_was_learned_is_one(
    emitter: OpticalEmitter, sink: EmitterSink
) -> None:
    emitter.started(PPG, 135, 1.0)
    for number in (0, 1, 2, 3, 4, 7):
        emitter.frame(*light(number, 55))
    assert sink.losses == {"ppg": 2 * COUNT}


def test_what_the_device_has_no_stream_for_is_passed_over(
    emitter: OpticalEmitter, sink: EmitterSink
) -> None:
    with capture_logs() as logs:
        emitter.started(Measurement.ECG, 130, 1.0)
        emitter.frame(struct.pack("<BQB", Measurement.ECG, START_NS, 0) + bytes(3), ARRIVAL_S)
    assert (sink.emitted, sink.dropped_bytes, logs) == ({}, 0, [])


@given(st.lists(st.tuples(st.lists(st.integers(0, 4000), max_size=40), st.booleans()), max_size=20))
def test_any_intervals_come_once_in_order(batches: list[tuple[list[int], bool]]) -> None:
    sink = EmitterSink("polar_verity_sense")
    emitter = OpticalEmitter(sink)
    for number, (lengths, is_new_connection) in enumerate(batches):
        if is_new_connection:
            emitter.reconnected()
        emitter.frame(ppi(0, *((ms, 6) for ms in lengths)), ARRIVAL_S + 5 * number)
    emitter.reconnected()
    sent = [ms / 1000 for lengths, _ in batches for ms in lengths if ms]
    assert [row[0] for row in sink.emitted.get("ppi", [])] == pytest.approx(sent)
    assert all(name in {"ppi"} for name in sink.emitted)


def test_every_measurement_has_a_stream_of_its_own(sink: EmitterSink) -> None:
    declared = {stream.data_name for stream in sink.spec.streams}
    assert set(DATA_NAMES.values()) <= declared
    assert all(a != b for a, b in pairwise(sorted(DATA_NAMES.values())))


# Layouts that only optical sensors send, against vectors; others are tested for the strap.
VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors" / "polar_optical.json").read_text(encoding="utf-8")
)
DATA = [vector for vector in VECTORS if vector["kind"] == "data"]
REPLIES = {vector["name"]: vector for vector in VECTORS if vector["kind"] == "control_point"}


def samples(data: bytes, factors: dict[int, float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    frame = parse_frame(data, factors)
    assert not isinstance(frame, Rejected | PulseIntervals)
    return np.array(frame.samples, np.float64)


@pytest.mark.parametrize("vector", DATA, ids=lambda vector: vector["name"])
def test_frame(vector: dict[str, Any]) -> None:
    data, expected = bytes.fromhex(vector["hex"]), vector["expected"]
    frame = parse_frame(data, {expected["type"]: vector["factor"]})
    assert not isinstance(frame, Rejected)
    header = frame.header
    assert (header.measurement, header.timestamp_ns, header.frame_type) == (
        expected["type"],
        expected["timestamp_ns"],
        expected["layout"],
    )
    found = samples(data, {expected["type"]: vector["factor"]})
    np.testing.assert_allclose(found, np.array(expected["samples"], np.float64), rtol=1e-12)


@pytest.mark.parametrize("vector", DATA, ids=lambda vector: vector["name"])
def test_a_frame_that_is_cut_is_dropped_or_ends_with_a_block(vector: dict[str, Any]) -> None:
    data, kind = bytes.fromhex(vector["hex"]), vector["expected"]["type"]
    whole = samples(data, {kind: vector["factor"]})
    kept = 0
    for length in range(len(data)):
        cut = parse_frame(data[:length], {kind: vector["factor"]})
        if not isinstance(cut, Rejected | PulseIntervals):
            kept += 1
            np.testing.assert_array_equal(np.array(cut.samples), whole[: len(cut.samples)])
    # Where a block ends, there alone.
    assert kept < len(whole)


@pytest.mark.parametrize("name", [name for name in REPLIES if "settings" in name])
def test_settings(name: str) -> None:
    reply = parse_indication(bytes.fromhex(REPLIES[name]["hex"]))
    assert isinstance(reply, Reply)
    found = {
        key.name.lower(): list(values) for key, values in parse_settings(reply.parameters).items()
    }
    assert found == REPLIES[name]["expected"]


def test_the_factor_of_a_reply_scales_the_frames() -> None:
    reply = parse_indication(bytes.fromhex(REPLIES["start_gyro_ok_with_factor"]["hex"]))
    assert isinstance(reply, Reply)
    assert parse_settings(reply.parameters)[Setting.FACTOR] == pytest.approx((0.07,))


def test_a_start_names_the_channels_in_one_byte() -> None:
    reply = parse_indication(bytes.fromhex(REPLIES["settings_ppg_says_135_has_55"]["hex"]))
    assert isinstance(reply, Reply)
    chosen = choose(parse_settings(reply.parameters), {Setting.SAMPLE_RATE: 55})
    assert start(Measurement.PPG, chosen).hex() == "0201" + "00018700" + "01011600" + "040104"


@pytest.mark.parametrize(
    ("model", "firmware", "sdk_mode", "rates"),
    [
        ("Verity Sense", "1.1.4", False, {}),
        ("Verity Sense", "1.1.5", False, {135: 55}),
        ("Verity Sense", "2.0.9", False, {135: 55}),
        ("Verity Sense", "2.1.0", False, {}),
        ("Verity Sense", "1.1.5", True, {}),
        ("OH1", "2.1.17", False, {130: 135}),
        ("OH1+", "", False, {130: 135}),
        ("360", "2.0.8", False, {}),
        ("Verity Sense", "", False, {}),
        ("", "", False, {}),
    ],
)
def test_true_rates(model: str, firmware: str, *, sdk_mode: bool, rates: dict[int, int]) -> None:
    info = DeviceInfo(model=model, firmware_version=firmware)
    assert true_ppg_rates(info, sdk_mode=sdk_mode) == rates
