"""LSL time to ROS time, and the pairs of LSL and unix time in events."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.ros_clock import (
    ClockPair,
    OffsetTracker,
    measure_clock_pair,
    measure_offset_ns,
    read_clock_pair,
)

# LSL time to ROS time.

OFFSET_NS = 1_760_000_000_123_456_789
NOW_S = 3_600.0


class Clocks:
    """A system and an LSL clock that advance by a scripted delay at each reading."""

    def __init__(self, delays_ns: Iterator[int]) -> None:
        self._delays = delays_ns
        self._elapsed_ns = 0
        self.set_by_ns = 0

    def _tick(self) -> int:
        self._elapsed_ns += next(self._delays)
        return self._elapsed_ns

    def system_ns(self) -> int:
        return self._tick() + OFFSET_NS + self.set_by_ns

    def lsl_s(self) -> float:
        return self._tick() / 1e9


def test_the_closest_bracket_gives_the_offset() -> None:
    preempted = [100, 50_000, 900_000]
    quiet = [100, 200, 200]
    clocks = Clocks(iter([*preempted, *quiet, *preempted]))

    assert abs(measure_offset_ns(clocks.system_ns, clocks.lsl_s, rounds=3) - OFFSET_NS) <= 1


@given(st.lists(st.integers(0, 10**6), min_size=30, max_size=30))
def test_error_is_at_most_half_the_closest_bracket(delays: list[int]) -> None:
    clocks = Clocks(iter(delays))
    widths = [delays[k + 1] + delays[k + 2] for k in range(0, 30, 3)]

    error = measure_offset_ns(clocks.system_ns, clocks.lsl_s) - OFFSET_NS

    assert abs(error) <= min(widths) / 2 + 1


def test_a_clock_set_back_between_the_reads_is_not_believed() -> None:
    clocks = Clocks(iter([100] * 6))

    def lsl_s() -> float:
        clocks.set_by_ns = -(10**9)
        return clocks.lsl_s()

    assert abs(measure_offset_ns(clocks.system_ns, lsl_s, rounds=2) - OFFSET_NS + 10**9) <= 1


def test_at_least_one_round() -> None:
    clocks = Clocks(iter([]))

    with pytest.raises(ValueError, match="one round"):
        measure_offset_ns(clocks.system_ns, clocks.lsl_s, rounds=0)


@given(st.floats(0.0, 8e6), st.integers(0, 2**62))
def test_the_sum_is_exact_to_the_nanosecond(lsl_s: float, offset_ns: int) -> None:
    exact = Fraction(lsl_s) * 10**9 + offset_ns

    assert abs(OffsetTracker(offset_ns, 0.0).to_ros_ns(lsl_s) - exact) <= Fraction(501, 1000)


def test_a_small_change_is_reached_in_a_second_without_a_jump() -> None:
    tracker = OffsetTracker(OFFSET_NS, NOW_S)

    assert tracker.update(OFFSET_NS + 800_000, NOW_S + 1) is None

    def applied(lsl_s: float) -> int:
        return tracker.to_ros_ns(lsl_s) - round(lsl_s * 1e9)

    assert applied(NOW_S) == OFFSET_NS
    assert applied(NOW_S + 1) == OFFSET_NS
    assert applied(NOW_S + 1.25) == OFFSET_NS + 200_000
    assert applied(NOW_S + 2) == OFFSET_NS + 800_000
    assert applied(NOW_S + 90) == OFFSET_NS + 800_000
    assert tracker.steps == 0


@pytest.mark.parametrize("size_ns", [-3_600_000_000_000, -1_000_001, 1_000_001, 10**12])
def test_a_large_change_is_a_step_at_once(size_ns: int) -> None:
    tracker = OffsetTracker(OFFSET_NS, NOW_S)

    step = tracker.update(OFFSET_NS + size_ns, NOW_S + 1)

    assert step == size_ns
    assert tracker.steps == 1
    assert tracker.to_ros_ns(NOW_S + 1) == 3_601 * 10**9 + OFFSET_NS + size_ns


def test_times_before_an_update_keep_their_offset() -> None:
    tracker = OffsetTracker(OFFSET_NS, NOW_S)
    tracker.update(OFFSET_NS + 500_000, NOW_S + 1)
    times = [NOW_S + 0.01 * k for k in range(150)]
    before = [tracker.to_ros_ns(time) for time in times]

    tracker.update(OFFSET_NS - 300_000, NOW_S + 1.5)

    assert [tracker.to_ros_ns(time) for time in times] == before


@pytest.mark.parametrize("slew_ppm", [-500, 20, 500])
def test_a_slewed_system_clock_is_followed_within_a_millisecond(slew_ppm: int) -> None:
    tracker = OffsetTracker(OFFSET_NS, 0.0)
    for second in range(1, 120):
        assert tracker.update(OFFSET_NS + slew_ppm * 1000 * second, float(second)) is None
        for part in range(10):
            lsl_s = second + part / 10
            true = round(lsl_s * 1e9) + OFFSET_NS + round(slew_ppm * 1000 * lsl_s)
            assert abs(tracker.to_ros_ns(lsl_s) - true) < 1_000_000


@given(st.lists(st.tuples(st.integers(-1_000_000, 1_000_000), st.floats(0.01, 5.0)), max_size=40))
def test_time_never_runs_back_without_a_step(updates: list[tuple[int, float]]) -> None:
    tracker = OffsetTracker(OFFSET_NS, NOW_S)
    now, offset = NOW_S, OFFSET_NS
    for change, wait in updates:
        now += wait
        offset += change // 4
        if tracker.update(offset, now) is not None:
            return
    times = [now - 10.0 + 0.01 * k for k in range(1_500)]
    mapped = [tracker.to_ros_ns(time) for time in times]
    assert all(later > earlier for earlier, later in pairwise(mapped))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_readings_must_be_finite(bad: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        OffsetTracker(OFFSET_NS, bad)
    tracker = OffsetTracker(OFFSET_NS, NOW_S)
    with pytest.raises(ValueError, match="finite"):
        tracker.update(OFFSET_NS, bad)
    with pytest.raises(ValueError, match="finite"):
        tracker.to_ros_ns(bad)


@given(
    updates=st.lists(
        st.tuples(st.integers(-1_000_000, 1_000_000), st.floats(0.01, 5.0)), max_size=20
    ),
    at_s=st.floats(-60.0, 60.0),
)
def test_the_way_back_leads_to_where_it_came_from(
    updates: list[tuple[int, float]], at_s: float
) -> None:
    tracker = OffsetTracker(OFFSET_NS, NOW_S)
    now_s, offset_ns = NOW_S, OFFSET_NS
    for change_ns, later_s in updates:
        now_s, offset_ns = now_s + later_s, offset_ns + change_ns
        tracker.update(offset_ns, now_s)

    there_and_back = tracker.to_lsl_s(tracker.to_ros_ns(now_s + at_s))

    assert there_and_back == pytest.approx(now_s + at_s, abs=1e-8)


# Pairs of LSL and unix time in events.
@given(st.floats(0, 1e8), st.integers(0, 2**63 - 1))
def test_a_pair_survives_json(lsl_s: float, unix_ns: int) -> None:
    pair = ClockPair(lsl_s, unix_ns)
    assert read_clock_pair(json.loads(json.dumps(pair.as_facts()))) == pair


def test_both_clocks_are_read_at_one_moment() -> None:
    began_s = time.monotonic()
    pair = measure_clock_pair(time.time_ns, time.monotonic)
    before_ns = time.time_ns()
    now_s = time.monotonic()
    after_ns = time.time_ns()
    assert began_s <= pair.lsl_s <= now_s
    then_ns = pair.unix_ns + (now_s - pair.lsl_s) * 1e9
    assert before_ns - 1e6 <= then_ns <= after_ns + 1e6


@pytest.mark.parametrize(
    "event",
    [
        None,
        [],
        {},
        {"clock": 5},
        {"clock": {"lsl_s": 1.0}},
        {"clock": {"lsl_s": "1", "unix_ns": 1}},
        {"clock": {"lsl_s": float("nan"), "unix_ns": 1}},
        {"clock": {"lsl_s": True, "unix_ns": 1}},
        {"clock": {"lsl_s": 1.0, "unix_ns": 1.5}},
        {"clock": {"lsl_s": 1.0, "unix_ns": -1}},
        {"clock": {"lsl_s": 1.0, "unix_ns": 2**63}},
    ],
)
def test_what_is_no_pair_is_none(event: object) -> None:
    assert read_clock_pair(event) is None
