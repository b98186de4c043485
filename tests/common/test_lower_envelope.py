"""The line under the points, and timelines that are made with it."""

from __future__ import annotations

import math
import random
from itertools import pairwise
from statistics import fmean, median, pstdev

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.clocks import MonotonicStamps, PacketTimeline, SampleTimeline
from biosensor_common.lower_envelope import SLOPE_LIMIT, LowerEnvelope

# The line under the points.

delays = st.lists(st.floats(0.0, 0.15), min_size=1, max_size=80)


@given(delays, st.floats(-200e-6, 200e-6))
def test_line_runs_closely_under_all_points(heights: list[float], slope: float) -> None:
    envelope = LowerEnvelope(0.0)
    points = [(0.0, 0.0)]
    for place, height in enumerate(heights, start=1):
        points.append((float(place), slope * place + height))
        envelope.add(*points[-1])

    distances = [y - envelope.at(x) for x, y in points]
    assert min(distances) >= -1e-9
    assert min(distances) <= 1.5 * median(distances) / (len(points) - 1) + 1e-9


def test_expected_distance_of_the_best_packet_is_taken_off() -> None:
    rng = random.Random(7)
    misses: list[float] = []
    for _ in range(100):
        envelope = LowerEnvelope(0.0)
        for place in range(1, 60):
            envelope.add(place * 0.5, rng.expovariate(1 / 0.05))
        misses.append(envelope.at(15.0))

    assert abs(sum(misses) / len(misses)) < 0.0015


@given(delays)
def test_slope_stays_within_the_limit(heights: list[float]) -> None:
    envelope = LowerEnvelope(0.0)
    for place, height in enumerate(heights, start=1):
        envelope.add(place * 0.5, -height)
        assert abs(envelope.slope) <= SLOPE_LIMIT


def test_two_points_do_not_outweigh_the_prior() -> None:
    envelope = LowerEnvelope(50e-6)

    envelope.add(1.0, 0.02)

    assert envelope.slope == pytest.approx(50e-6, abs=25e-6)


def test_many_points_outweigh_the_prior() -> None:
    rng = random.Random(1)
    envelope = LowerEnvelope(-100e-6)
    for place in range(1, 1200):
        x = place / 10
        envelope.add(x, 180e-6 * x + rng.uniform(0.0, 0.1))

    assert envelope.slope == pytest.approx(180e-6, abs=10e-6)


def test_points_out_of_order_make_the_same_line() -> None:
    rng = random.Random(2)
    points = [(place / 4, rng.uniform(0.0, 0.05)) for place in range(1, 200)]
    ordered, shuffled = LowerEnvelope(0.0), LowerEnvelope(0.0)
    for point in points:
        ordered.add(*point)
    for place in range(0, len(points), 4):
        for point in reversed(points[place : place + 4]):
            shuffled.add(*point)
    for envelope in (ordered, shuffled):
        envelope.add(60.0, 1.0)

    assert shuffled.at(50.0) == pytest.approx(ordered.at(50.0), abs=5e-4)


def test_a_step_down_forgets_what_was_before() -> None:
    envelope = LowerEnvelope(0.0)
    for place in range(1, 100):
        envelope.add(float(place), 0.0)

    for place in range(100, 110):
        envelope.add(float(place), -0.5)

    # Ten points leave some slopes open; with those from before the step it would be at its limit.
    assert envelope.slope == pytest.approx(0.0, abs=10e-6)
    assert envelope.residual_rms() == pytest.approx(0.0, abs=100e-6)


def test_old_points_leave_the_window() -> None:
    envelope = LowerEnvelope(0.0)
    for place in range(1, 400):
        envelope.add(float(place), 0.0 if place < 100 else 0.1)

    assert envelope.at(399.0) == pytest.approx(0.1, abs=1e-9)


# Packet numbers, timelines of regular samples, monotonic stamps.
ECG_PERIOD_S = 0.004
ECG_SAMPLES = 63
ECG_PACKET_S = ECG_PERIOD_S * ECG_SAMPLES


def timeline_at(number: int, modulus: int = 256) -> PacketTimeline:
    timeline = PacketTimeline(modulus)
    assert timeline.place(number) is None
    return timeline


@pytest.mark.parametrize(
    ("previous", "current", "lost"),
    [(0, 1, 0), (255, 0, 0), (254, 1, 2), (10, 14, 3), (7, 7, 255)],
)
def test_numbers_tell_lost_packets(previous: int, current: int, lost: int) -> None:
    assert timeline_at(previous).steps(current) == lost + 1


@pytest.mark.parametrize("number", [256, -1])
def test_numbers_that_cannot_be_are_refused(number: int) -> None:
    with pytest.raises(ValueError, match="outside"):
        PacketTimeline(256).steps(number)


@given(
    st.integers(1, 32).flatmap(
        lambda bits: st.tuples(
            st.just(1 << bits), st.integers(0, 2**40), st.lists(st.integers(1, 2**40))
        )
    ),
    st.floats(-0.49, 0.49),
)
def test_numbers_and_time_restore_the_counts_over_any_gap(
    case: tuple[int, int, list[int]], error: float
) -> None:
    modulus, start, gaps = case
    timeline = timeline_at(start % modulus, modulus)
    first, count = start % modulus, start
    for gap in gaps:
        count += gap
        # Time need not be exact: half a turn either way is enough.
        assert timeline.place(count % modulus, gap + error * modulus) == gap
        assert timeline.newest == count - start + first


@pytest.mark.parametrize(("number", "steps"), [(250, 0), (249, -1), (200, -50), (5, 11)])
def test_a_packet_may_come_late_or_twice(number: int, steps: int) -> None:
    assert timeline_at(250).steps(number, 1.0, None) == steps


@pytest.mark.parametrize(("number", "steps"), [(5, 261), (0, 256), (255, 511)])
def test_a_packet_is_no_nearer_than_it_can_be(number: int, steps: int) -> None:
    assert timeline_at(0).steps(number, 0.0, 256) == steps


def test_to_look_at_a_packet_changes_nothing() -> None:
    timeline = timeline_at(200)
    assert [timeline.steps(201), timeline.steps(202)] == [1, 2]
    assert timeline.newest == 200


def test_a_timeline_that_forgets_begins_again() -> None:
    timeline = timeline_at(200)
    timeline.place(10)
    timeline.forget()
    assert timeline.place(5) is None
    assert timeline.newest == 5


@pytest.mark.parametrize("drift_ppm", [-200, 0, 160, 200])
def test_jittering_stamps_become_an_even_timeline(drift_ppm: int) -> None:
    rng = random.Random(drift_ppm)
    timeline = SampleTimeline(ECG_PERIOD_S)
    errors: list[float] = []
    firsts: list[float] = []
    for packet in range(1000):
        true = 50.0 + packet * ECG_PACKET_S * (1 + drift_ppm * 1e-6)
        firsts.append(timeline.place(true + rng.uniform(-0.002, 0.002), ECG_SAMPLES))
        errors.append(firsts[-1] - true)

    settled = errors[100:]
    assert timeline.reanchors == 0
    assert pstdev(settled) < 0.0003
    assert abs(fmean(settled)) < 0.001
    gaps = [later - earlier - ECG_PACKET_S for earlier, later in pairwise(firsts[100:])]
    assert max(map(abs, gaps)) < 0.0004


def test_lost_samples_keep_their_place() -> None:
    timeline = SampleTimeline(ECG_PERIOD_S)
    timeline.place(10.0, ECG_SAMPLES)

    first = timeline.place(10.0 + 3 * ECG_PACKET_S, ECG_SAMPLES, lost=2 * ECG_SAMPLES)

    assert first == pytest.approx(10.0 + 3 * ECG_PACKET_S)
    assert timeline.reanchors == 0


@pytest.mark.parametrize("jump", [-5.0, -0.03, 0.03, ECG_PACKET_S, 3600.0])
def test_a_stamp_far_from_the_chain_starts_it_again(jump: float) -> None:
    timeline = SampleTimeline(ECG_PERIOD_S)
    timeline.place(10.0, ECG_SAMPLES)
    stamp = 10.0 + ECG_PACKET_S + jump

    assert timeline.place(stamp, ECG_SAMPLES) == stamp
    assert timeline.reanchors == 1
    assert timeline.place(stamp + ECG_PACKET_S, ECG_SAMPLES) == pytest.approx(stamp + ECG_PACKET_S)


def test_tolerance_grows_with_the_period() -> None:
    timeline = SampleTimeline(0.056)
    timeline.place(10.0, 18)

    timeline.place(10.0 + 18 * 0.056 + 0.027, 18)

    assert timeline.reanchors == 0


def test_timeline_refuses_nonsense() -> None:
    for period in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="sampling period"):
            SampleTimeline(period)
    timeline = SampleTimeline(1.0)
    for stamp, n, lost in ((math.nan, 1, 0), (math.inf, 1, 0), (0.0, -1, 0), (0.0, 1, -1)):
        with pytest.raises(ValueError, match="cannot place"):
            timeline.place(stamp, n, lost)


def test_increasing_stamps_pass_unchanged() -> None:
    monotonic = MonotonicStamps()

    assert monotonic.apply([1.0, 2.0]) == [1.0, 2.0]
    assert monotonic.apply([2.5]) == [2.5]
    assert monotonic.corrections == 0


def test_stamps_that_run_back_are_moved_and_counted() -> None:
    monotonic = MonotonicStamps()
    monotonic.apply([5.0])

    assert monotonic.apply([4.0, 5.0, 6.0]) == pytest.approx([5.000001, 5.000002, 6.0], abs=1e-9)
    assert monotonic.corrections == 2


@given(st.lists(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=32))))
def test_emitted_stamps_strictly_increase(chunks: list[list[float]]) -> None:
    monotonic = MonotonicStamps()
    emitted = [stamp for chunk in chunks for stamp in monotonic.apply(chunk)]
    given_stamps = [stamp for chunk in chunks for stamp in chunk]

    assert all(later > earlier for earlier, later in pairwise(emitted))
    moved = [a != b for a, b in zip(given_stamps, emitted, strict=True)]
    assert sum(moved) == monotonic.corrections


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_stamps_must_be_finite(bad: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        MonotonicStamps().apply([bad])
