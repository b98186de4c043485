"""Gaps are found by the stamps, which may be anything, and in whatever blocks they come."""

from __future__ import annotations

import math
from itertools import accumulate, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_common.lsl.inlet import Stamps
from lsl_to_ros.statistics.losses import FOREIGN_JITTER_S, GAP_PERIODS, Gap, GapFinder

RATE = 100.0
PERIOD = 1 / RATE

# Times of a sender: neighbours, jitter, gaps, and steps back.
steps = st.one_of(
    st.just(PERIOD), st.floats(-0.05, 0.05), st.floats(0.0, 5.0), st.floats(-5.0, 0.0)
)
times = st.lists(steps, min_size=1, max_size=60).map(
    lambda all_: [*accumulate(all_, initial=1000.0)]
)
# What another program may write instead of a time.
nonsense = st.sampled_from([math.nan, math.inf, -math.inf])
mixed = times.flatmap(
    lambda stamps: st.tuples(*(st.just(stamp) | nonsense for stamp in stamps)).map(list)
)
rates = st.sampled_from([0.0, 4.0, RATE, 1e6])
cuts = st.lists(st.integers(1, 60), max_size=10)


def spaced(count: int, step: float) -> Stamps:
    return np.array([2.0 + number * step for number in range(count)])


def one_at_a_time(finder: GapFinder, stamps: list[float]) -> list[Gap]:
    found: list[Gap] = []
    for place, stamp in enumerate(stamps):
        found += [Gap(place, gap.missing) for gap in finder.find(np.array([stamp]))]
    return found


def in_blocks(finder: GapFinder, stamps: list[float], cut: list[int]) -> list[Gap]:
    found: list[Gap] = []
    edges = sorted({0, len(stamps), *(place for place in cut if place < len(stamps))})
    for start, end in pairwise(edges):
        gaps = finder.find(np.array(stamps[start:end]))
        found += [Gap(start + gap.place, gap.missing) for gap in gaps]
    return found


def compare(stamps: list[float], cut: list[int], rate: float, *, foreign: bool) -> None:
    singly, together = (GapFinder(rate, foreign=foreign) for _ in range(2))
    assert in_blocks(together, stamps, cut) == one_at_a_time(singly, stamps)
    assert together.last_stamp == singly.last_stamp


@settings(deadline=None)
@given(stamps=times, cut=cuts, rate=rates, foreign=st.booleans())
def test_one_at_a_time_and_in_blocks_give_the_same(
    stamps: list[float], cut: list[int], rate: float, foreign: bool
) -> None:
    compare(stamps, cut, rate, foreign=foreign)


@settings(deadline=None)
@given(stamps=mixed, cut=cuts, rate=rates, foreign=st.booleans())
def test_so_do_stamps_that_are_no_times(
    stamps: list[float], cut: list[int], rate: float, foreign: bool
) -> None:
    compare(stamps, cut, rate, foreign=foreign)


@settings(deadline=None)
@given(
    stamps=st.lists(st.floats(width=64), min_size=1, max_size=20),
    cut=cuts,
    rate=st.sampled_from([0.0, 1e-300, RATE, 1e6]),
)
def test_so_does_any_number(stamps: list[float], cut: list[int], rate: float) -> None:
    compare(stamps, cut, rate, foreign=True)


@settings(deadline=None)
@given(missing=st.lists(st.integers(0, 1000), min_size=1, max_size=30), rate=st.floats(1.0, 1000.0))
def test_what_is_missing_is_counted(missing: list[int], rate: float) -> None:
    numbers = accumulate((1 + count for count in missing), initial=0)
    stamps = np.array([5000.0 + number / rate for number in numbers])
    gaps = GapFinder(rate, foreign=False).find(stamps)
    expected = [Gap(place, count) for place, count in enumerate(missing, 1) if count]
    assert gaps == expected


def test_the_first_sample_ever_comes_after_no_gap() -> None:
    assert GapFinder(RATE, foreign=False).find(np.array([7.0])) == []
    assert GapFinder(RATE, foreign=False).find(np.array([7.0, 7.01])) == []


def test_between_two_blocks_there_can_be_a_gap() -> None:
    finder = GapFinder(RATE, foreign=False)
    finder.find(np.array([1.0, 1.01]))
    assert finder.find(np.array([1.06, 1.07])) == [Gap(0, 4)]
    assert finder.find(np.array([1.12])) == [Gap(0, 4)]


def test_a_stamp_that_is_a_little_late_is_no_gap() -> None:
    late = spaced(10, PERIOD * GAP_PERIODS * 0.99)
    assert GapFinder(RATE, foreign=False).find(late) == []
    too_late = spaced(3, PERIOD * GAP_PERIODS * 1.01)
    assert [gap.place for gap in GapFinder(RATE, foreign=False).find(too_late)] == [1, 2]


def test_stamps_of_other_programs_may_jitter() -> None:
    jitter = spaced(10, FOREIGN_JITTER_S * 0.99)
    assert GapFinder(RATE, foreign=True).find(jitter) == []
    assert len(GapFinder(RATE, foreign=False).find(jitter)) == 9
    assert GapFinder(RATE, foreign=True).find(np.array([1.0, 1.2])) == [Gap(1, 19)]


def test_a_slow_stream_of_another_program_has_its_own_measure() -> None:
    assert GapFinder(1.0, foreign=True).find(np.array([1.0, 2.4])) == []
    assert GapFinder(1.0, foreign=True).find(np.array([1.0, 3.0])) == [Gap(1, 1)]


@settings(deadline=None)
@given(stamps=mixed)
def test_an_irregular_stream_has_no_gaps_but_a_newest_stamp(stamps: list[float]) -> None:
    finder = GapFinder(0.0, foreign=False)
    assert finder.find(np.array(stamps)) == []
    assert finder.last_stamp == next((s for s in reversed(stamps) if math.isfinite(s)), 0.0)


@pytest.mark.parametrize("stamp", [math.nan, math.inf, -math.inf])
def test_what_is_no_time_is_never_the_newest_stamp(stamp: float) -> None:
    finder = GapFinder(RATE, foreign=True)
    assert finder.find(np.array([stamp])) == []
    assert finder.last_stamp == 0.0
    finder.find(np.array([5.0, stamp]))
    assert finder.last_stamp == 5.0


def test_a_step_back_is_no_gap() -> None:
    finder = GapFinder(RATE, foreign=False)
    assert finder.find(np.array([9.0, 3.0, 3.01])) == []
    assert finder.last_stamp == 3.01
