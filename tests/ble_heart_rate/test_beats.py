"""Beats are placed where they happened, not where their packets arrived."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from biosensor_gateway.devices.ble_heart_rate.driver.beats import (
    NARROW_S,
    REANCHOR_S,
    BeatClock,
    walk_back,
)

Floats = NDArray[np.float64]


def heart(beats: int, seed: int = 1) -> Floats:
    """Return when a heart beats, 0.7 to 0.9 s apart, in seconds."""
    intervals = np.random.default_rng(seed).uniform(0.7, 0.9, beats)
    return 100.0 + np.cumsum(intervals)


def placed(beat_times: Floats, scale: float = 1.0) -> tuple[Floats, Floats]:
    """Return true and placed times of all beats, reported in packets once a second."""
    clock, found, truth = BeatClock(), list[float](), list[float]()
    intervals = np.diff(beat_times, prepend=beat_times[0] - 0.8)
    for second in range(int(beat_times[0]) + 1, int(beat_times[-1]) + 1):
        due = (beat_times > second - 1) & (beat_times <= second)
        found += clock.place(tuple(scale * intervals[due]), second)
        truth += list(beat_times[due])
    return np.array(truth), np.array(found)


def test_several_intervals_are_walked_back() -> None:
    assert walk_back(10.0, [0.5, 0.25, 1.0]) == [8.75, 9.0, 10.0]
    assert walk_back(10.0, []) == []


def test_the_first_packet_is_anchored_at_its_arrival() -> None:
    assert BeatClock().place([0.75, 0.5], 20.0) == [19.5, 20.0]


def test_beats_are_placed_where_they_were_whenever_packets_come() -> None:
    truth, found = placed(heart(400))
    settled = slice(50, None)
    error = found[settled] - truth[settled]
    assert np.max(np.abs(error)) < 0.1
    np.testing.assert_allclose(np.diff(found[settled]), np.diff(truth[settled]), atol=0.03)


def test_intervals_cut_to_whole_units_do_not_add_up_to_a_jump() -> None:
    truth, found = placed(heart(4000), scale=0.9994)
    error = (found - truth)[50:]
    assert np.max(np.abs(error)) < 0.1
    assert np.max(np.abs(np.diff(error))) < 0.02


def test_a_missing_beat_is_noticed() -> None:
    times = heart(200)
    clock, error = BeatClock(), 0.0
    intervals = np.diff(times, prepend=times[0] - 0.8)
    intervals[100] = 0.0
    for second in range(int(times[0]) + 1, int(times[-1]) + 1):
        due = (times > second - 1) & (times <= second)
        found = clock.place(tuple(intervals[due]), second)
        error = found[-1] - times[due][-1] if found else error
    assert abs(error) < 0.05


def test_too_many_missing_beats_move_the_clock_at_once() -> None:
    clock = BeatClock()
    clock.place([0.8], 50.0)
    clock.place([], 55.0)
    assert clock.place([0.8, 0.8], 60.0) == [59.2, 60.0]


def test_a_strap_that_sends_each_beat_at_once_is_believed() -> None:
    clock, times = BeatClock(), heart(100)
    intervals = np.diff(times, prepend=times[0] - 0.8)
    found = [clock.place([each], time)[0] for each, time in zip(intervals, times, strict=True)]
    np.testing.assert_allclose(found, times, atol=0.01)


def test_a_packet_that_comes_earlier_than_its_beats_moves_them() -> None:
    clock = BeatClock()
    clock.place([0.8], 50.0)
    assert clock.place([0.8], 50.5) == [50.5]


@given(
    st.lists(
        st.tuples(
            st.lists(st.floats(0, 64), max_size=9),
            st.floats(0, 100),
        ),
        max_size=50,
    )
)
def test_no_beat_is_later_than_its_packet(packets: list[tuple[list[float], float]]) -> None:
    clock, arrival = BeatClock(), 1000.0
    for intervals, pause in packets:
        arrival += pause
        times = clock.place(intervals, arrival)
        assert len(times) == len(intervals)
        assert all(a <= b for a, b in pairwise(times))
        if times:
            assert arrival - REANCHOR_S - NARROW_S <= times[-1] <= arrival + 1e-6
