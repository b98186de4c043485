"""Device time and lost samples from a counter of 24 bits."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.shimmer.driver.packets import Placed, TickTimeline

DIVISOR = 256
PERIOD_S = DIVISOR / 32768
TURN = 1 << 24
TURN_S = 512.0


def started(divisor: int = DIVISOR) -> TickTimeline:
    timeline = TickTimeline()
    timeline.started(divisor)
    return timeline


def place(timeline: TickTimeline, ticks: int, arrival_s: float) -> Placed:
    placed = timeline.place(ticks % TURN, arrival_s)
    assert placed is not None
    return placed


def test_steady_packets_have_their_own_times_and_no_loss() -> None:
    timeline = started()
    first = TURN - 3 * DIVISOR
    placed = [place(timeline, first + k * DIVISOR, 100 + k * PERIOD_S) for k in range(8)]
    assert [each.time_s for each in placed] == [first / 32768 + k * PERIOD_S for k in range(8)]
    assert [each.lost for each in placed] == [0] * 8


@given(
    first=st.integers(0, TURN - 1),
    missing=st.integers(0, 3_000_000),
    early_s=st.floats(-9.0, 9.0),
    divisor=st.sampled_from([32, 65, 256, 640]),
)
def test_a_gap_of_any_length_is_counted(
    first: int, missing: int, early_s: float, divisor: int
) -> None:
    timeline = started(divisor)
    place(timeline, first, 1000.0)
    gap_s = (missing + 1) * divisor / 32768
    placed = place(timeline, first + (missing + 1) * divisor, 1000.0 + max(0.0, gap_s + early_s))
    assert placed == Placed(first / 32768 + gap_s, missing)


@given(first=st.integers(0, TURN - 1), gap_s=st.floats(0.5, 5000.0), late_s=st.floats(-0.9, 0.9))
def test_a_counter_that_survives_a_connection_goes_on_without_a_loss(
    first: int, gap_s: float, late_s: float
) -> None:
    timeline = started()
    place(timeline, first, 1000.0)
    timeline.started(DIVISOR)
    step = max(1, round(gap_s * 32768))
    placed = place(timeline, first + step, 1000.0 + gap_s + late_s)
    # Nothing was measured in between.
    assert placed == Placed((first + step) / 32768, 0)


@given(
    first=st.integers(0, TURN - 1),
    gap_s=st.floats(0.5, 5000.0),
    off_s=st.floats(2.0, 510.0),
)
def test_a_restarted_counter_is_told_and_nothing_counts_as_lost(
    first: int, gap_s: float, off_s: float
) -> None:
    timeline = started()
    before = place(timeline, first, 1000.0)
    timeline.started(DIVISOR)
    restarted = first + round((gap_s + off_s) * 32768)
    placed = place(timeline, restarted, 1000.0 + gap_s)
    assert placed.restarted
    assert placed.lost == 0
    assert before.time_s < placed.time_s < before.time_s + gap_s + TURN_S + 1
    following = place(timeline, restarted + 3 * DIVISOR, 1000.0 + gap_s + 3 * PERIOD_S)
    assert following == Placed(placed.time_s + 3 * PERIOD_S, 2)


def test_a_repeated_packet_is_left_out() -> None:
    timeline = started()
    place(timeline, 500, 10.0)
    assert timeline.place(500, 10.0) is None
    assert place(timeline, 500 + DIVISOR, 10.0).lost == 0


def test_a_late_burst_is_no_restart_and_no_loss() -> None:
    timeline = started()
    place(timeline, 500, 10.0)
    placed = [place(timeline, 500 + k * DIVISOR, 16.0) for k in range(1, 5)]
    assert [(each.lost, each.restarted) for each in placed] == [(0, False)] * 4


@given(st.lists(st.tuples(st.integers(0, TURN - 1), st.floats(0, 600)), max_size=60))
def test_whatever_comes_time_goes_on(packets: list[tuple[int, float]]) -> None:
    timeline, arrival_s, times = started(), 0.0, list[float]()
    for ticks, pause_s in packets:
        arrival_s += pause_s
        placed = timeline.place(ticks, arrival_s)
        if placed is not None:
            assert placed.lost >= 0
            times.append(placed.time_s)
    assert all(a < b for a, b in pairwise(times))


@pytest.mark.parametrize("divisor", [65, 256])
def test_jitter_of_the_stamp_is_no_loss(divisor: int) -> None:
    timeline = started(divisor)
    placed = [place(timeline, 1000 + k * divisor + k % 3, 10 + k * divisor / 32768)
              for k in range(100)]  # fmt: skip
    assert {each.lost for each in placed} == {0}
