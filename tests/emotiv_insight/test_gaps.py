"""Losses and repetitions, from counter and time."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.emotiv_insight.driver.emitter import SampleCount

START_S = 1.7e9
NAN = math.nan


class Feed:
    """Feeds samples of one long recording, by their number."""

    def __init__(self, rate_hz: float = 128.0, *, counted: bool = True) -> None:
        self.count = SampleCount(rate_hz)
        self._rate, self._counted = rate_hz, counted

    def __call__(self, number: int, step_s: float = 0.0) -> int | None:
        time_s = round(START_S + number / self._rate + step_s, 4)
        counter = number % round(self._rate) if self._counted else NAN
        return self.count.lost_before(counter, time_s, number / self._rate)


@given(
    st.lists(st.integers(1, 2000), min_size=1, max_size=20),
    st.sampled_from([32.0, 64.0, 128.0, 256.0]),
    st.booleans(),
)
def test_every_loss_is_found(steps: list[int], rate_hz: float, counted: bool) -> None:
    feed, number = Feed(rate_hz, counted=counted), 5
    assert feed(number) == 0
    for step in steps:
        number += step
        assert feed(number) == step - 1


@given(st.integers(1, 300), st.integers(0, 60))
def test_what_comes_twice_is_known(sent: int, back: int) -> None:
    feed = Feed()
    for number in range(sent + 1):
        feed(number)
    again = max(0, sent - back)
    assert [feed(number) for number in range(again, sent + 1)] == [None] * (sent + 1 - again)
    assert feed(sent + 1) == 0


@pytest.mark.parametrize("step_s", [-3600.0, -30.0, -1.0, -0.5, 0.5, 1.0, 5.0, 3600.0])
def test_a_clock_that_is_set_loses_nothing(step_s: float) -> None:
    feed = Feed()
    assert [feed(0), feed(1)] == [0, 0]
    assert [feed(2, step_s), feed(3, step_s), feed(6, step_s)] == [0, 0, 2]
    assert feed(6 + 129, step_s) == 128


def test_a_clock_that_is_set_in_a_gap_hides_no_loss() -> None:
    feed = Feed()
    feed(0)
    assert feed(1 + 3 * 128, 3600.0) == 3 * 128
    uncounted = Feed(counted=False)
    uncounted(0)
    assert uncounted(1 + 3 * 128, 3600.0) == 3 * 128


@given(st.lists(st.floats(0.0, 5.0), min_size=2, max_size=50), st.floats(-150e-6, 150e-6))
def test_late_arrivals_and_a_drifting_clock_are_no_losses(
    delays_s: list[float], drift: float
) -> None:
    count, arrival_s = SampleCount(128.0), 0.0
    for number, delay_s in enumerate(delays_s):
        time_s = number / 128
        arrival_s = max(arrival_s, time_s * (1 + drift) + delay_s)
        if number == 0:
            arrival_s = 0.0
        assert count.lost_before(number % 128, START_S + time_s, arrival_s) == 0


def test_a_counter_that_does_not_survive_a_connection_leaves_the_time() -> None:
    feed = Feed()
    feed(0)
    feed.count.reconnected()
    assert feed.count.lost_before(77, START_S + 3.0, 3.0) == 3 * 128 - 1
    assert feed.count.lost_before(78, START_S + 3.0 + 1 / 128, 3.0) == 0


def test_nothing_is_known_of_the_time_in_which_the_headset_was_off() -> None:
    feed = Feed()
    feed(0)
    feed.count.forget()
    assert feed(100_000) == 0


def test_a_day_is_no_gap() -> None:
    feed = Feed()
    feed(0)
    feed.count.reconnected()
    assert feed(128 * 100_000) == 0


@pytest.mark.parametrize("counter", [NAN, math.inf, -1.0, 200.0, 3.5])
def test_a_counter_that_cannot_be_is_left_out(counter: float) -> None:
    count = SampleCount(64.0)
    assert count.lost_before(counter, START_S, 0.0) == 0
    assert count.lost_before(counter, START_S + 4 / 64, 4 / 64) == 3


def test_a_fractional_rate_has_no_known_counter() -> None:
    count = SampleCount(6.4)
    assert count.lost_before(5, START_S, 0.0) == 0
    assert count.lost_before(0, START_S + 2 / 6.4, 0.3) == 1
