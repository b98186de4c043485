"""The estimate of what the radio lost: from numbers of samples and their arrival alone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_gateway.devices.empatica_e4.driver.emitter import BRIDGED_S, WINDOW_S, LossEstimate

RATE_HZ = 64.0
HOUR_S = 3600.0


def arrivals(
    seconds: float, *, drift_ppm: float = 0.0, jitter_s: float = 0.0, seed: int = 0
) -> np.ndarray:
    """When samples of a wristband arrive; positive drift is a slow oscillator."""
    count = int(seconds * RATE_HZ)
    measured = np.arange(count) / RATE_HZ * (1 + drift_ppm * 1e-6)
    delays = np.random.default_rng(seed).uniform(0, jitter_s, count)
    return np.maximum.accumulate(measured + delays)


def estimates(times: Iterable[float], estimate: LossEstimate | None = None) -> Iterator[float]:
    estimate = estimate or LossEstimate(RATE_HZ)
    for time in times:
        lost_s = estimate.take(1, float(time))
        if lost_s is not None:
            yield lost_s


@pytest.mark.parametrize("drift_ppm", [-200, 47, 200, 400])
def test_drift_of_the_oscillator_is_no_loss_however_long(drift_ppm: float) -> None:
    told = list(estimates(arrivals(HOUR_S, drift_ppm=drift_ppm, jitter_s=0.05)))
    assert len(told) == pytest.approx(HOUR_S / WINDOW_S, abs=2)
    assert set(told) == {0.0}


@settings(max_examples=30)
@given(
    share=st.floats(0.01, 0.9),
    drift_ppm=st.floats(-200, 200),
    jitter_s=st.floats(0, 0.1),
    seed=st.integers(0, 99),
)
def test_a_share_of_lost_samples_is_found(
    share: float, drift_ppm: float, jitter_s: float, seed: int
) -> None:
    times = arrivals(120, drift_ppm=drift_ppm, jitter_s=jitter_s, seed=seed)
    kept = times[np.random.default_rng(seed).random(len(times)) >= share]
    told = sum(estimates(kept))
    # Of steady loss, the two newest windows are not told yet; drift may hide a little.
    told_until_s = 120 - 2 * WINDOW_S
    assert told_until_s * share * 0.85 - 0.5 < told < 120 * share * 1.1 + 0.3


@settings(max_examples=30)
@given(st.floats(0.2, 8.0), st.floats(11.0, 30.0))
def test_a_hole_is_told_once_and_whole(hole_s: float, begin_s: float) -> None:
    times = arrivals(80, jitter_s=0.03)
    kept = times[(times < begin_s) | (times >= begin_s + hole_s)]
    told = [lost_s for lost_s in estimates(kept) if lost_s]
    assert len(told) == 1
    assert told[0] == pytest.approx(hole_s, abs=0.06)


def test_a_known_gap_is_told_at_the_end_of_its_own_window() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(60)
    before = list(estimates(times[times < 25], estimate))
    estimate.begin_window()
    after = list(estimates(times[times >= 30], estimate))
    assert set(before) == {0.0}
    assert after[0] == pytest.approx(5.0, abs=0.05)
    assert set(after[1:]) == {0.0}


def test_a_first_sample_that_came_late_hides_no_gap() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(30)
    times[0] = times[20]
    assert list(estimates(times[times < 5], estimate)) == []
    estimate.begin_window()
    told = list(estimates(np.sort(times[times >= 6]), estimate))
    assert told[0] == pytest.approx(1.0, abs=0.05)


def test_a_backlog_is_no_loss() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(60)
    # A server that is held up for 4 s sends everything after it.
    late = np.where((times > 22) & (times < 26), 26.0, times)
    assert set(estimates(late, estimate)) == {0.0}


def test_what_came_before_a_long_silence_says_nothing() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(200 + BRIDGED_S)
    kept = times[(times < 30) | (times > 31 + BRIDGED_S)]
    assert set(estimates(kept, estimate)) == {0.0}


def test_being_switched_off_is_no_loss() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(100)
    assert set(estimates(times[times < 30], estimate)) == {0.0}
    estimate.forget()
    assert set(estimates(times[times > 50], estimate)) == {0.0}


@given(st.lists(st.integers(1, 40), min_size=5, max_size=30))
def test_it_does_not_matter_how_samples_are_read_together(sizes: list[int]) -> None:
    times = arrivals(45)
    one, many = LossEstimate(RATE_HZ), LossEstimate(RATE_HZ)
    ends = np.cumsum(sizes)
    ends = [*ends[ends < len(times)].tolist(), len(times)]
    for begin, end in zip([0, *ends], ends, strict=False):
        arrival = float(times[end - 1])
        for _ in range(begin, end - 1):
            assert one.take(1, arrival) in (None, 0.0)
        assert one.take(1, arrival) in (None, 0.0)
        assert many.take(end - begin, arrival) in (None, 0.0)
