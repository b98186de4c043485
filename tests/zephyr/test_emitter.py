"""What each message of a BioHarness puts into which stream, and what it does not."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from biosensor_gateway.devices.zephyr.driver.emitter import ZephyrEmitter
from biosensor_gateway.devices.zephyr.driver.messages import (
    Acceleration,
    Event,
    General,
    Header,
    Lifesign,
    Message,
    Number,
    Reply,
    RrIntervals,
    Status,
    Summary,
    Unknown,
    Waveform,
)
from biosensor_gateway.devices.zephyr.driver.protocol import MessageId
from tests.rigs.emitter_sink import EmitterSink

NOON = dt.datetime(2026, 1, 30, 12)  # noqa: DTZ001 - naive, as the device means it
NOON_S = (NOON - dt.datetime(2000, 1, 1)).total_seconds()  # noqa: DTZ001 - the device's epoch
ARRIVAL_S = 5_000.0
NAN = math.nan
WORN_CHANGE = 0x1040
VITALS = {"hr", "hrv", "br", "posture", "activity", "st", "bat", "rssi", "quality"}

NUMBERS: dict[str, Number] = {
    "heart_rate_bpm": 71,
    "respiration_rate_bpm": 15.4,
    "skin_temperature_c": 33.1,
    "posture_deg": 11,
    "activity_vmu_g": 0.35,
    "battery_percent": 57,
    "heart_rate_confidence": 95,
    "hrv_ms": 103,
    "link_quality": 254,
    "rssi_db": -24,
}


@pytest.fixture
def sink() -> EmitterSink:
    return EmitterSink("zephyr")


@pytest.fixture
def emitter(sink: EmitterSink) -> ZephyrEmitter:
    return ZephyrEmitter(sink)


def header(number: int = 0, seconds: float = 0.0) -> Header:
    return Header(number % 256, NOON + dt.timedelta(seconds=seconds))


def summary(
    number: int = 0, *, status: int = 0, head: Header | None = None, **changes: Number
) -> Summary:
    head = head or header(number, number)
    return Summary(head, 2, {**NUMBERS, **changes}, Status(status), "green", 25, {})


def general(number: int = 0, *, worn: bool = True, low: bool = False, **changes: Number) -> General:
    return General(
        header(number, number), {**NUMBERS, **changes}, 57, worn, False, low, False
    )  # fmt: skip


def ecg(number: int, seconds: float) -> Waveform:
    samples = tuple(range(number, number + 63))
    return Waveform(MessageId.ECG, header(number, seconds), samples, 0.004)


def worn_event(code: bytes, seconds: float) -> Event:
    return Event(header(0, seconds), WORN_CHANGE, "worn_change", code)


def test_ecg_stays_counts_at_4_ms(emitter: ZephyrEmitter, sink: EmitterSink) -> None:
    emitter.take(ecg(7, 0.0), ARRIVAL_S)
    assert sink.emitted == {"ecg": [[float(value)] for value in range(7, 70)]}
    expected = [NOON_S + 0.004 * index for index in range(63)]
    assert sink.times["ecg"] == pytest.approx(expected, abs=1e-6)
    # The clock is told when the last sample was measured, and when that arrived.
    assert sink.observed == [(sink.times["ecg"][-1], ARRIVAL_S)]


def test_breathing_stays_counts_at_56_ms(emitter: ZephyrEmitter, sink: EmitterSink) -> None:
    samples = tuple(range(500, 518))
    emitter.take(Waveform(MessageId.BREATHING, header(), samples, 0.056), ARRIVAL_S)
    assert sink.emitted == {"breathing": [[float(value)] for value in samples]}
    assert np.diff(sink.times["breathing"]) == pytest.approx([0.056] * 17, abs=1e-6)


@pytest.mark.parametrize(
    ("counts", "scale"), [({}, (512, 20.75)), ({"counts_per_g": 10.0, "zero": 0}, (0, 10))]
)
def test_acceleration_becomes_g(
    emitter: ZephyrEmitter, sink: EmitterSink, counts: dict[str, Any], scale: tuple[int, float]
) -> None:
    samples = tuple((490 + k, 512, 533 - k) for k in range(20))
    emitter.take(Acceleration(header(), samples, **counts), ARRIVAL_S)
    zero, per_g = scale
    np.testing.assert_allclose(sink.emitted["acc"], (np.array(samples) - zero) / per_g)
    assert np.diff(sink.times["acc"]) == pytest.approx([0.02] * 19, abs=1e-6)


def test_intervals_become_seconds_at_the_time_of_their_beat(
    emitter: ZephyrEmitter, sink: EmitterSink
) -> None:
    emitter.take(RrIntervals(header(), (800,) * 10 + (-812,) * 8), ARRIVAL_S)
    assert sink.emitted == {"ibi": [[0.812]]}
    assert sink.times["ibi"] == pytest.approx([NOON_S + 10 * 0.056], abs=1e-6)


def test_a_gap_makes_no_beat_and_no_guess(emitter: ZephyrEmitter, sink: EmitterSink) -> None:
    emitter.take(RrIntervals(header(0), (800,) * 18), ARRIVAL_S)
    emitter.take(RrIntervals(header(2, 2 * 1.008), (-900,) * 18), ARRIVAL_S + 2)
    assert sink.emitted == {}
    assert sink.losses == {}


def test_a_summary_fills_the_vitals(emitter: ZephyrEmitter, sink: EmitterSink) -> None:
    emitter.take(summary(), ARRIVAL_S)
    assert sink.emitted == {
        "hr": [[71]],
        "hrv": [[103]],
        "br": [[15.4]],
        "posture": [[11]],
        "activity": [[0.35]],
        "st": [[33.1]],
        "bat": [[57]],
        "rssi": [[-24]],
        "quality": [[1, 95, 0, 0, 0, 254]],
    }
    assert {time for times in sink.times.values() for time in times} == {NOON_S}


@pytest.mark.parametrize(
    ("data_name", "number"),
    [
        ("hr", "heart_rate_bpm"),
        ("hrv", "hrv_ms"),
        ("br", "respiration_rate_bpm"),
        ("posture", "posture_deg"),
        ("activity", "activity_vmu_g"),
        ("st", "skin_temperature_c"),
        ("bat", "battery_percent"),
        ("rssi", "rssi_db"),
    ],
)
def test_no_value_is_not_published(
    emitter: ZephyrEmitter, sink: EmitterSink, data_name: str, number: str
) -> None:
    emitter.take(replace(summary(), numbers={**NUMBERS, number: None}), ARRIVAL_S)
    assert sink.emitted.keys() == VITALS - {data_name}


@pytest.mark.parametrize(
    ("data_name", "number"), [("hr", "heart_rate_bpm"), ("br", "respiration_rate_bpm")]
)
def test_a_rate_of_0_is_no_value(
    emitter: ZephyrEmitter, sink: EmitterSink, data_name: str, number: str
) -> None:
    emitter.take(replace(summary(), numbers={**NUMBERS, number: 0.0}), ARRIVAL_S)
    assert sink.emitted.keys() == VITALS - {data_name}


@pytest.mark.parametrize(
    ("status", "quality"),
    [
        (0x0000, [1, 95, 0, 0, 0, 254]),
        (0x0002, [1, 95, 0, 0, 0, 254]),
        (0x0003, [0, 95, 0, 0, 0, 254]),
        (0x0010, [1, 95, 1, 0, 0, 254]),
        (0x0020, [1, 95, 0, 1, 0, 254]),
        (0x0200, [1, 95, 0, 0, 1, 254]),
    ],
)
def test_the_status_word_goes_into_quality_and_filters_only_respiration(
    emitter: ZephyrEmitter, sink: EmitterSink, status: int, quality: list[float]
) -> None:
    emitter.take(summary(status=status), ARRIVAL_S)
    assert sink.emitted["quality"] == [quality]
    missing = VITALS - sink.emitted.keys()
    assert missing == ({"br"} if status == 0x0020 else set())


def test_unknown_confidence_is_nan(emitter: ZephyrEmitter, sink: EmitterSink) -> None:
    emitter.take(summary(heart_rate_confidence=None, link_quality=None), ARRIVAL_S)
    np.testing.assert_array_equal(sink.emitted["quality"], [[1, NAN, 0, 0, 0, NAN]])


@pytest.mark.parametrize(("worn", "low"), [(True, False), (False, True)])
def test_general_data_fill_what_they_hold(
    emitter: ZephyrEmitter, sink: EmitterSink, worn: bool, low: bool
) -> None:
    emitter.take(general(worn=worn, low=low), ARRIVAL_S)
    np.testing.assert_array_equal(
        sink.emitted.pop("quality"), [[float(worn), NAN, float(low), NAN, NAN, NAN]]
    )
    assert sink.emitted == {
        "hr": [[71]], "br": [[15.4]], "posture": [[11]], "activity": [[0.35]],
        "st": [[33.1]], "bat": [[57]],
    }  # fmt: skip


def test_lost_packets_are_counted_in_samples(emitter: ZephyrEmitter, sink: EmitterSink) -> None:
    emitter.take(ecg(0, 0.0), ARRIVAL_S)
    emitter.take(ecg(4, 4 * 0.252), ARRIVAL_S + 1)
    assert sink.losses == {"ecg": 3 * 63}


def test_lost_summaries_count_for_the_streams_that_the_last_one_filled(
    emitter: ZephyrEmitter, sink: EmitterSink
) -> None:
    emitter.take(summary(0, hrv_ms=None), ARRIVAL_S)
    emitter.take(summary(3), ARRIVAL_S + 3)
    assert sink.losses == dict.fromkeys(VITALS - {"hrv"}, 2)


def test_a_reconnection_is_a_gap_of_known_length(emitter: ZephyrEmitter, sink: EmitterSink) -> None:
    emitter.take(ecg(0, 0.0), ARRIVAL_S)
    emitter.take(summary(0), ARRIVAL_S)
    emitter.take(RrIntervals(header(), (800,) * 18), ARRIVAL_S)
    emitter.reconnected()
    emitter.take(ecg(200, 10 * 0.252), ARRIVAL_S + 10 * 0.252)
    assert sink.losses == {"ecg": 9 * 63}
    emitter.take(RrIntervals(header(200, 3 * 1.008), (-900,) * 18), ARRIVAL_S + 3)
    assert "ibi" not in sink.emitted


def test_taking_the_strap_off_shows_at_once(emitter: ZephyrEmitter, sink: EmitterSink) -> None:
    emitter.take(summary(), ARRIVAL_S)
    emitter.take(worn_event(b"\x64\x00", 0.4), ARRIVAL_S + 0.4)
    emitter.take(worn_event(b"\x00\x64", 0.7), ARRIVAL_S + 0.7)
    assert [sample[0] for sample in sink.emitted["quality"]] == [1, 0, 1]
    assert sink.times["quality"] == [NOON_S, NOON_S + 0.4, NOON_S + 0.7]


@pytest.mark.parametrize("data", [b"", b"\x64"])
def test_an_event_that_is_cut_short_changes_nothing(
    emitter: ZephyrEmitter, sink: EmitterSink, data: bytes
) -> None:
    emitter.take(summary(), ARRIVAL_S)
    emitter.take(worn_event(data, 0.4), ARRIVAL_S + 0.4)
    assert len(sink.emitted["quality"]) == 1


def test_an_event_before_all_data_is_kept_for_the_log(
    emitter: ZephyrEmitter, sink: EmitterSink
) -> None:
    with capture_logs() as logs:
        emitter.take(worn_event(b"\x00\x64", 0.0), ARRIVAL_S)
    assert sink.emitted == {}
    assert [(entry["event"], entry["name"]) for entry in logs] == [("event", "worn_change")]


@pytest.mark.parametrize(
    "message",
    [Lifesign(), Unknown(0x60), Reply(0x16, True, b""), Event(header(), 0x0040, "button", b"")],
    ids=lambda message: type(message).__name__,
)
def test_messages_without_values_emit_nothing(
    emitter: ZephyrEmitter, sink: EmitterSink, message: Message
) -> None:
    emitter.take(message, ARRIVAL_S)
    assert (sink.emitted, sink.observed) == ({}, [])


def test_without_a_device_clock_everything_happens_when_it_arrives(
    emitter: ZephyrEmitter, sink: EmitterSink
) -> None:
    emitter.take(Waveform(MessageId.ECG, Header(0, None), (512,) * 63, 0.004), ARRIVAL_S)
    emitter.take(summary(head=Header(0, None)), ARRIVAL_S)
    assert sink.times["ecg"][-1] == pytest.approx(ARRIVAL_S - 0.004)
    assert sink.times["hr"] == [ARRIVAL_S]
    assert all(arrival - device >= -1e-9 for device, arrival in sink.observed)
