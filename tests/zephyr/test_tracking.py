"""Gaps, places and beats: what packets say of the samples that are missing."""

from __future__ import annotations

import datetime as dt
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.refusal import Refusal
from biosensor_gateway.devices.zephyr.driver.emitter import (
    BeatDetector,
    PacketTrack,
    Placed,
    ZephyrEmitter,
)
from biosensor_gateway.devices.zephyr.driver.messages import Header, RrIntervals
from tests.rigs.emitter_sink import EmitterSink

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
