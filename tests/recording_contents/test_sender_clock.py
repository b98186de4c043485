"""Stamps on the clock of the recorder."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.recording.xdf.measuring import summarise_offsets
from biosensor_gateway.recording.xdf.sender_clock import SenderClock


def _offsets(
    begin_s: float, count: int, offset_s: float, ppm: float, noise: np.ndarray
) -> list[tuple[float, float]]:
    times = begin_s + 5.0 * np.arange(count)
    values = offset_s + ppm * 1e-6 * (times - begin_s) + noise
    return list(zip(times.tolist(), values.tolist(), strict=True))


def test_without_offsets_stamps_stay() -> None:
    stamps = np.array([1.0, 2.0])
    clock = SenderClock([])
    assert not clock.is_known
    assert clock.to_recorder(stamps).tolist() == stamps.tolist()


@pytest.mark.parametrize("damaged", [1e200, -1e12, np.inf, np.nan])
@pytest.mark.parametrize("place", [0, 1])
def test_what_no_clock_can_read_is_passed_over(damaged: float, place: int) -> None:
    offsets = _offsets(100.0, 20, 3.0, 0.0, np.zeros(20))
    wrong = list(offsets[10])
    wrong[place] = damaged
    clock = SenderClock([*offsets[:10], (wrong[0], wrong[1]), *offsets[10:]])
    assert clock.restarts == 0
    assert clock.to_recorder(np.array([150.0]), offsets_before=12).tolist() == [153.0]
    assert not SenderClock([(wrong[0], wrong[1])]).is_known


@given(
    st.floats(0, 1e6),
    st.integers(20, 400),
    st.floats(-1e5, 1e5),
    st.floats(-200, 200),
    st.integers(0, 2**32),
)
def test_a_clock_that_drifts_is_followed_in_spite_of_a_busy_network(
    begin_s: float, count: int, offset_s: float, ppm: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    noise = random.normal(0, 50e-6, count)
    late = random.choice(count, count // 10, replace=False)
    noise[late] += 0.08
    clock = SenderClock(_offsets(begin_s, count, offset_s, ppm, noise))
    stamps = np.linspace(begin_s, begin_s + 5.0 * (count - 1), 50)
    true = stamps + offset_s + ppm * 1e-6 * (stamps - begin_s)
    assert np.abs(clock.to_recorder(stamps, count // 2) - true).max() < 0.5e-3
    assert clock.restarts == 0


def test_two_offsets_say_nothing_of_drift() -> None:
    clock = SenderClock([(100.0, 0.001), (105.0, 0.003)])
    assert clock.to_recorder(np.array([1000.0]))[0] == pytest.approx(1000.002)


@pytest.mark.parametrize("before_offset", [True, False])
def test_a_computer_that_was_started_again_has_a_line_of_its_own(before_offset: bool) -> None:
    none = np.zeros(10)
    first = _offsets(5000.0, 10, 2.0, 0.0, none)
    second = _offsets(20.0, 10, 5100.0, 0.0, none)
    clock = SenderClock([*first, *second])
    assert clock.restarts == 1
    assert clock.to_recorder(np.array([5020.0]), 4)[0] == pytest.approx(5022.0)
    stamps = np.array([18.0 if before_offset else 30.0])
    moved = clock.to_recorder(stamps, 10 if before_offset else 12)
    assert moved[0] == pytest.approx(stamps[0] + 5100.0)


@pytest.mark.parametrize("step_s", [0.06, 0.6, -0.6])
def test_a_clock_that_was_set_by_less_than_a_second_has_two_lines(step_s: float) -> None:
    noise = np.random.default_rng(3).normal(0, 100e-6, 40)
    offsets = _offsets(100.0, 40, 3.0, 20.0, noise)
    offsets[20:] = [(time_s + step_s, offset - step_s) for time_s, offset in offsets[20:]]
    clock = SenderClock(offsets)
    assert clock.restarts == 1
    before, after = (
        clock.to_recorder(np.array([110.0]), 3),
        clock.to_recorder(np.array([290.0]), 39),
    )
    assert before[0] == pytest.approx(113.0, abs=1e-3)
    assert after[0] == pytest.approx(293.0 - step_s, abs=5e-3)
    told = summarise_offsets(offsets)
    assert told.resets == 1
    assert told.scatter_s is not None
    assert told.scatter_s < 1e-3


def test_the_last_offset_of_an_outlet_that_goes_is_no_reset() -> None:
    offsets = _offsets(5000.0, 6, 0.0, 0.0, np.zeros(6))
    told = summarise_offsets([*offsets, (805030.0, -775000.0)])
    assert (told.resets, told.drift_ppm, told.scatter_s) == (0, 0.0, 0.0)
