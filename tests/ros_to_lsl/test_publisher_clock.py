"""A publisher's clock is judged by the fastest of its messages."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.ros_clock import NS_PER_S
from lsl_to_ros.ros_to_lsl.stamps import (
    AHEAD_S,
    BEHIND_S,
    PATIENCE_S,
    WAY_S,
    ClockState,
    Offset,
    PublisherClock,
)
from tests.ros_to_lsl.conftest import NOW_NS

PERIOD_NS = NS_PER_S // 100


def observed(seconds: float, offset_s: float, jitter_s: float = 0.0) -> PublisherClock:
    """Return a clock that was watched for a time; its offset is arrival minus stamp at no delay."""
    clock, chance = PublisherClock(), random.Random(1)
    for number in range(int(seconds * 100)):
        stamp_ns = NOW_NS + number * PERIOD_NS
        delay_s = offset_s + chance.expovariate(1 / jitter_s) if jitter_s else offset_s
        clock.observe(stamp_ns, stamp_ns + round(delay_s * NS_PER_S))
    return clock


def test_nothing_is_known_of_a_clock_that_was_never_seen() -> None:
    clock = PublisherClock()
    clock.look(NOW_NS)
    assert clock.state is ClockState.UNKNOWN
    assert not clock.is_in_doubt
    assert math.isnan(clock.edge_s)


@pytest.mark.parametrize("offset_s", [0.0001, WAY_S * 0.9, -AHEAD_S / 2])
def test_a_clock_that_is_right_is_so_with_its_first_message(offset_s: float) -> None:
    assert observed(0.01, offset_s).state is ClockState.SYNCHRONISED
    clock = observed(10.0, offset_s, jitter_s=0.01)
    assert clock.state is ClockState.SYNCHRONISED
    assert clock.edge_s == pytest.approx(offset_s, abs=0.02)


def test_a_message_from_the_future_is_enough() -> None:
    clock = observed(0.01, -2 * AHEAD_S)
    assert clock.state is ClockState.WRONG
    assert clock.edge_s == pytest.approx(-2 * AHEAD_S)


def test_late_messages_put_a_clock_in_doubt_until_they_stay_late() -> None:
    offset_s = BEHIND_S + 1
    early = observed(PATIENCE_S / 2, offset_s)
    assert early.is_in_doubt
    late = observed(PATIENCE_S + 1, offset_s, jitter_s=0.1)
    assert late.state is ClockState.WRONG
    assert late.edge_s == pytest.approx(offset_s, abs=0.05)


def test_a_single_late_message_is_judged_when_nothing_else_comes() -> None:
    clock = observed(0.01, BEHIND_S + 5)
    clock.look(NOW_NS + round((BEHIND_S + 5 + PATIENCE_S / 2) * NS_PER_S))
    assert clock.is_in_doubt
    clock.look(NOW_NS + round((BEHIND_S + 6 + PATIENCE_S) * NS_PER_S))
    assert clock.state is ClockState.WRONG


def test_a_backlog_that_catches_up_was_the_way_not_the_clock() -> None:
    clock = observed(PATIENCE_S / 2, BEHIND_S + 1)
    stamp_ns = NOW_NS + NS_PER_S * 3
    clock.observe(stamp_ns, stamp_ns + 1000)
    assert clock.state is ClockState.SYNCHRONISED


def test_a_clock_that_is_set_back_later_is_found() -> None:
    clock = observed(5.0, 0.001)
    for number in range(20_000):
        stamp_ns = NOW_NS + 5 * NS_PER_S + number * PERIOD_NS
        clock.observe(stamp_ns - 60 * NS_PER_S, stamp_ns)
    assert clock.state is ClockState.WRONG


def test_a_late_run_of_a_clock_that_is_right_is_forgiven() -> None:
    clock = observed(5.0, 0.001)
    for number in range(300):
        stamp_ns = NOW_NS + 5 * NS_PER_S + number * PERIOD_NS
        clock.observe(stamp_ns, stamp_ns + 5 * NS_PER_S)
    assert clock.state is ClockState.SYNCHRONISED


@given(delays=st.lists(st.integers(0, 20_000_000), min_size=1, max_size=50))
def test_no_delays_make_a_right_clock_wrong(delays: list[int]) -> None:
    clock = PublisherClock()
    for number, delay_ns in enumerate(delays):
        stamp_ns = NOW_NS + number * 100 * PERIOD_NS
        clock.observe(stamp_ns, stamp_ns + delay_ns)
    assert clock.state is ClockState.SYNCHRONISED


@pytest.mark.parametrize("offset_s", [0.05, 0.5, 0.95])
def test_a_clock_that_may_be_behind_is_not_called_synchronised(offset_s: float) -> None:
    clock = observed(PATIENCE_S + 1, offset_s, jitter_s=0.002)
    assert clock.state is ClockState.BEHIND
    assert clock.edge_s == pytest.approx(offset_s, abs=0.005)
    # One message that comes at once shows that it was the way.
    stamp_ns = NOW_NS + 4 * NS_PER_S
    clock.observe(stamp_ns, stamp_ns + NS_PER_S // 1000)
    assert clock.state is ClockState.SYNCHRONISED


def test_a_clock_that_is_set_back_by_less_than_a_second_is_found_too() -> None:
    clock = observed(5.0, 0.001)
    for number in range(2000):
        stamp_ns = NOW_NS + 5 * NS_PER_S + number * PERIOD_NS
        clock.observe(stamp_ns - NS_PER_S // 2, stamp_ns)
    assert clock.state is ClockState.BEHIND
    assert clock.edge_s == pytest.approx(0.5, abs=0.01)


MEASURED = [
    (Offset(-0.501, -0.499), ClockState.WRONG),
    (Offset(-0.001, 0.0005), ClockState.SYNCHRONISED),
    (Offset(0.010, 0.011), ClockState.WRONG),
    # Too wide to tell.
    (Offset(-0.5, 0.001), ClockState.BEHIND),
]


@pytest.mark.parametrize(("offset", "state"), MEASURED)
def test_a_measurement_tells_the_clock_from_the_way(offset: Offset, state: ClockState) -> None:
    clock = observed(PATIENCE_S + 1, 0.5)
    clock.take_offset(offset)
    assert clock.state is state
    later_ns = NOW_NS + 4 * NS_PER_S
    for number in range(3000):
        stamp_ns = later_ns + number * PERIOD_NS
        clock.observe(stamp_ns, stamp_ns + NS_PER_S // 2)
    assert clock.state is state
