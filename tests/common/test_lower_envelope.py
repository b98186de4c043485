"""The line under the points."""

from __future__ import annotations

import random
from statistics import median

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.lower_envelope import SLOPE_LIMIT, LowerEnvelope

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
