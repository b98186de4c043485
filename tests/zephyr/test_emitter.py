"""What each message of a BioHarness puts into which stream, and what it does not."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_common.refusal import Refusal
from biosensor_gateway.devices.zephyr import SPEC
from biosensor_gateway.devices.zephyr.driver.emitter import (
    BeatDetector,
    PacketTrack,
    Placed,
    ZephyrEmitter,
)
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
    labels = [channel.label for channel in SPEC.stream("quality").channels]
    assert [*sink.lacking["quality"]] == [labels[each] for each in (1, 3, 4, 5)]
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


# Gaps, places and beats: what packets say of the samples that are missing.

SAMPLES, PERIOD_S = 63, 0.004
DURATION_S = SAMPLES * PERIOD_S
DAY_PACKETS = round(86_400 / DURATION_S)
POWER_ON = dt.datetime(2026, 1, 30, 10)  # noqa: DTZ001 - naive, as the device means it
LSL_AT_POWER_ON_S = 5_000.0

GAPS = st.lists(st.integers(0, 255), min_size=1, max_size=30)
JITTER_MS = st.integers(-2, 2)


class Device:
    """Numbers and stamps its packets; knows how late each arrives."""

    def __init__(self, clock_is_set: bool = True) -> None:
        self.track = PacketTrack(SAMPLES, PERIOD_S)
        self.clock_is_set = clock_is_set
        self.ahead_s = 0.0
        self.first_number = 0
        self.numbers_a_packet = 1

    def arrive(self, index: int, jitter_ms: int = 0, delay_s: float = 0.05) -> Placed:
        placed = self.again(index, jitter_ms, delay_s)
        assert placed is not None
        return placed

    def again(self, index: int, jitter_ms: int = 0, delay_s: float = 0.05) -> Placed | None:
        seconds = index * DURATION_S + self.ahead_s + jitter_ms / 1000
        time = POWER_ON + dt.timedelta(seconds=seconds) if self.clock_is_set else None
        arrival_s = LSL_AT_POWER_ON_S + (index + 1) * DURATION_S + delay_s
        number = self.first_number + index * self.numbers_a_packet
        header = Header(number % 256, time)
        return self.track.place(header, arrival_s)

    def reconnect(self, first_number: int = 0) -> None:
        self.first_number = first_number
        self.track.reconnected()


@given(gaps=GAPS, jitter_ms=JITTER_MS, clock_is_set=st.booleans())
def test_within_a_connection_the_sequence_tells_every_gap(
    gaps: list[int], jitter_ms: int, clock_is_set: bool
) -> None:
    device, index = Device(clock_is_set), 0
    assert device.arrive(index).lost_packets == 0
    for gap in gaps:
        index += gap + 1
        assert device.arrive(index, jitter_ms).lost_packets == gap


@given(gap=st.integers(256, 2000), delay_s=st.floats(0, 5))
def test_a_gap_of_whole_cycles_is_seen_by_its_length(gap: int, delay_s: float) -> None:
    device = Device()
    device.arrive(0)
    assert device.arrive(gap + 1, delay_s=delay_s).lost_packets == gap


@given(gap=st.integers(0, DAY_PACKETS - 1), first_number=st.integers(0, 255), jitter_ms=JITTER_MS)
def test_over_a_reconnect_the_device_s_clock_tells_the_gap(
    gap: int, first_number: int, jitter_ms: int
) -> None:
    device = Device()
    for index in range(300):
        device.arrive(index)
    device.reconnect(first_number)
    assert device.arrive(300 + gap, jitter_ms).lost_packets == gap
    assert device.arrive(301 + gap).lost_packets == 0


@pytest.mark.parametrize("clock_is_set", [True, False])
def test_a_packet_that_comes_twice_is_passed_over(clock_is_set: bool) -> None:
    device = Device(clock_is_set)
    for index in range(40):
        device.arrive(index)
        assert device.again(index, delay_s=0.1) is None
    assert device.arrive(40).lost_packets == 0
    assert device.arrive(42).lost_packets == 1


def test_a_packet_that_came_before_others_is_passed_over() -> None:
    device = Device()
    for index in range(10):
        device.arrive(index)
    device.reconnect()
    assert [device.again(index, delay_s=5.0) for index in range(10)] == [None] * 10
    assert device.arrive(12).lost_packets == 2


@pytest.mark.parametrize("clock_is_set", [True, False])
@pytest.mark.parametrize("first_number", [-3, -1, 20, 128, 200])
def test_numbers_that_begin_again_make_no_gap(clock_is_set: bool, first_number: int) -> None:
    device = Device(clock_is_set)
    for index in range(300):
        device.arrive(index)
    device.first_number = first_number if clock_is_set else 128
    assert [device.arrive(index).lost_packets for index in (300, 301, 305)] == [0, 0, 3]


@pytest.mark.parametrize("clock_is_set", [True, False])
def test_numbers_that_stand_still_make_no_gap(clock_is_set: bool) -> None:
    device = Device(clock_is_set)
    device.numbers_a_packet = 0
    lost = [device.arrive(index).lost_packets for index in (*range(300), 310)]
    assert lost == [0] * 300 + [10]


@pytest.mark.parametrize("delay_s", [0.3, 3.0, 15.0, 60.0])
def test_what_waited_makes_no_gap_though_numbers_begin_again(delay_s: float) -> None:
    device = Device()
    for index in range(300):
        device.arrive(index)
    device.first_number = 128
    held = [device.arrive(index, delay_s=delay_s) for index in range(300, 360)]
    assert [placed.lost_packets for placed in held] == [0] * 60


@pytest.mark.parametrize(
    "step_s", [-86_400 * 365, -3600.0, -11.0, 11.0, 70.0, 3600.0, 86_400.0 * 365]
)
def test_setting_the_device_s_clock_loses_nothing(step_s: float) -> None:
    device = Device()
    device.arrive(0)
    device.ahead_s = step_s
    assert device.arrive(1).lost_packets == 0
    assert device.arrive(3).lost_packets == 1


@pytest.mark.parametrize("step_s", [-86_400 * 365, -3600.0, 3600.0])
@pytest.mark.parametrize("gap", [0, 10, 1000])
def test_if_the_clock_was_set_meanwhile_the_host_s_clock_tells_the_gap(
    step_s: float, gap: int
) -> None:
    device = Device()
    device.arrive(0)
    device.reconnect()
    device.ahead_s = step_s
    assert device.arrive(gap + 1).lost_packets == gap


def test_a_device_that_was_away_for_days_has_not_lost_days() -> None:
    device = Device()
    device.arrive(0)
    device.reconnect()
    assert device.arrive(2 * DAY_PACKETS).lost_packets == 0


def test_midnight_is_no_gap() -> None:
    device = Device()
    until_midnight = round(14 * 3600 / DURATION_S)
    device.arrive(until_midnight - 2)
    placed = [device.arrive(until_midnight + offset) for offset in range(-1, 3)]
    assert [each.lost_packets for each in placed] == [0] * 4
    assert [b.first_s - a.first_s for a, b in pairwise(placed)] == pytest.approx([DURATION_S] * 3)


@given(gaps=GAPS)
def test_samples_are_placed_where_the_device_measured_them(gaps: list[int]) -> None:
    device, index = Device(), 0
    start_s = device.arrive(0).first_s
    for gap in gaps:
        index += gap + 1
        times = device.track.times(device.arrive(index).first_s)
        assert len(times) == SAMPLES
        assert times[0] == pytest.approx(start_s + index * DURATION_S, abs=1e-3)
        steps = [b - a for a, b in pairwise(times)]
        assert steps == pytest.approx([PERIOD_S] * (SAMPLES - 1), abs=1e-6)


@given(gaps=GAPS)
def test_a_clock_that_was_never_set_is_replaced_by_counting(gaps: list[int]) -> None:
    device, index = Device(clock_is_set=False), 0
    assert device.arrive(0, delay_s=0.0).first_s == pytest.approx(LSL_AT_POWER_ON_S)
    for gap in gaps:
        index += gap + 1
        placed = device.arrive(index, delay_s=0.5)
        # However late a packet is: it is counted from the connection's first.
        assert placed.first_s == pytest.approx(LSL_AT_POWER_ON_S + index * DURATION_S)
        assert placed.lost_packets == gap


def test_a_clock_that_was_never_set_starts_again_with_a_connection() -> None:
    device = Device(clock_is_set=False)
    device.arrive(0, delay_s=0.0)
    device.reconnect()
    placed = device.arrive(500, delay_s=0.0)
    assert placed.first_s == pytest.approx(LSL_AT_POWER_ON_S + 500 * DURATION_S)
    assert placed.lost_packets == 499


def test_a_packet_that_is_stamped_at_its_end_happened_when_it_arrived() -> None:
    track = PacketTrack(1, 1.0, stamped_at_end=True)
    assert track.place(Header(7, None), 100.0) == Placed(100.0, 100.0, 0)
    assert track.place(Header(8, None), 101.4) == Placed(101.0, 101.0, 0)
    assert track.place(Header(10, None), 103.2) == Placed(103.0, 103.0, 1)


def readings(*values: int) -> RrIntervals:
    samples = (*values, *[values[-1]] * (18 - len(values)))
    return RrIntervals(Header(0, POWER_ON), samples)


def test_a_beat_is_where_the_reading_changes() -> None:
    beats = BeatDetector()
    assert beats.beats(readings(800, 800, -810, -810, 805)) == [(2, 0.81), (4, 0.805)]
    assert beats.beats(readings(805, -805)) == [(1, 0.805)]
    assert beats.beats(readings(790)) == [(0, 0.79)]


def test_the_first_reading_is_no_beat_nor_the_first_after_a_gap() -> None:
    beats = BeatDetector()
    assert beats.beats(readings(800)) == []
    beats.reset()
    assert beats.beats(readings(-750)) == []
    assert beats.beats(readings(760)) == [(0, 0.76)]


@given(st.integers(-12_498, 12_498).filter(lambda value: abs(value) not in (0, 800, 900)))
def test_an_implausible_interval_is_counted_and_hides_no_beat(reading: int) -> None:
    sink = EmitterSink("zephyr")
    ZephyrEmitter(sink).take(readings(800, 800, reading, -900), sink.clock())
    # Also of a heart that beats 24 times a minute.
    is_plausible = 250 <= abs(reading) <= 2500
    assert sink.values("ibi") == [*([abs(reading) / 1000] if is_plausible else []), 0.9]
    assert sink.refusals.count(Refusal.LEFT_OUT) == (not is_plausible)


@given(st.lists(st.integers(250, 1500), min_size=1, max_size=60))
def test_every_beat_is_found_once_with_its_interval(intervals: list[int]) -> None:
    """At 250 ms a beat lasts at least four readings of 56 ms."""
    stream: list[int] = [1]
    for number, interval in enumerate(intervals):
        stream += [interval if number % 2 else -interval] * max(1, interval // 56)
    stream += [stream[-1]] * (-len(stream) % 18)
    beats = BeatDetector()
    found = [
        interval_s
        for start in range(0, len(stream), 18)
        for _, interval_s in beats.beats(readings(*stream[start : start + 18]))
    ]
    assert found == [interval / 1000 for interval in intervals]
