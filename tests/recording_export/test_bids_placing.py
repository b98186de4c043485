"""Rows for samples whose times are what they are."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.recording.export.grid import place
from biosensor_gateway.recording.export.timing import find_timing
from biosensor_gateway.recording.xdf.header import RecordedHeader


def _header(rate: float, *, drops: bool = True) -> RecordedHeader:
    return RecordedHeader(
        name="a",
        content_type="ECG",
        source_id="",
        hostname="",
        channel_count=1,
        format=ChannelFormat.FLOAT32,
        rate=rate,
        created_at=0.0,
        labels=("1",),
        units=("",),
        can_drop_samples=drops,
        identity=None,
        data_name="",
        refused="",
    )


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=60), st.integers(-60, 60))
def test_every_sample_has_a_row_of_its_own_in_the_order_of_the_file(
    places: list[float], after: int
) -> None:
    rows = place(np.array(places), after)
    assert rows[0] > after
    assert (np.diff(rows) > 0).all()


@given(st.lists(st.integers(1, 9), min_size=1, max_size=60), st.floats(-0.49, 0.49))
def test_what_has_its_own_row_is_in_it(steps: list[int], phase: float) -> None:
    true = np.cumsum(steps)
    assert place(true + phase, 0).tolist() == true.tolist()


@given(st.lists(st.integers(0, 7), min_size=1, max_size=5))
def test_no_other_rows_are_nearer_to_all_together(places: list[int]) -> None:
    found = place(np.array(places, float), -100)
    cost = np.abs(found - places).sum()
    others = combinations(range(-5, 13), len(places))
    assert cost == min(sum(map(abs, np.subtract(each, places))) for each in others)


@pytest.mark.parametrize("late", [-7.0, 7.0])
def test_one_wrong_stamp_moves_no_other_sample(late: float) -> None:
    places = np.arange(100.0)
    places[50] += late
    assert place(places, -1).tolist() == list(range(100))


def test_the_rate_is_that_between_gaps() -> None:
    times = np.arange(5000) / 129.87
    times[2000:] += 3.3333
    noisy = times + np.random.default_rng(1).normal(0, 1e-4, len(times))
    timing = find_timing(np.array_split(noisy, 77), _header(130.0))
    assert timing is not None
    assert timing.rate_hz == pytest.approx(129.87, rel=1e-6)
    assert (timing.gaps, timing.longest_gap_s) == (1, pytest.approx(3.3333 + 1 / 129.87, abs=1e-3))
    (part,) = timing.parts
    assert part.count == 5000
    assert part.start_s == pytest.approx(0.0, abs=1e-4)


def test_the_rate_is_not_that_of_stamps_which_all_come_at_once() -> None:
    times = np.arange(20000) / 249.95
    times[5000:8000] = times[8000] - np.arange(3000, 0, -1) * 1e-6
    timing = find_timing(np.array_split(times, 11), _header(250.0))
    assert timing is not None
    assert timing.rate_hz == pytest.approx(249.95, rel=1e-4)


@pytest.mark.parametrize(
    "times", [np.zeros(500), np.array([1.0, 1.001]), np.array([3.0]), np.arange(40) * 1e-6]
)
def test_what_tells_no_rate_has_the_nominal_one(times: np.ndarray) -> None:
    timing = find_timing([times], _header(50.0))
    assert timing is not None
    assert timing.rate_hz == 50.0


def test_no_sample_has_no_timing() -> None:
    assert find_timing([], _header(50.0)) is None
