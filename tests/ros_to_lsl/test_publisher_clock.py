"""The clocks of publishers and of who answers, and which time a message gets."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable
from typing import cast

import pylsl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.ros_clock import NS_PER_S
from lsl_to_ros.ros_to_lsl.application import Bounds
from lsl_to_ros.ros_to_lsl.stamps import (
    AHEAD_S,
    BEHIND_S,
    PATIENCE_S,
    WAY_S,
    ClockState,
    Doubt,
    MessageStamping,
    Offset,
    PublisherClock,
    StampSource,
    doubt_of,
)
from lsl_to_ros.ros_to_lsl.topic_bridge import Doubts, PublicationLosses
from lsl_to_ros.statistics.ros_time import RosTime
from tests.ros_to_lsl.conftest import MILLISECOND, NOW_NS, info, stamped

# A publisher's clock is judged by the fastest of its messages.

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


@pytest.mark.parametrize("slow", [3e-4, 2e-3, 2e-2])
def test_a_clock_that_runs_slow_does_not_stay_synchronised(slow: float) -> None:
    clock = observed(5.0, 0.001)
    for number in range(150 * 20):
        passed_s = number / 20
        true_ns = NOW_NS + round((5 + passed_s) * NS_PER_S)
        clock.observe(true_ns - round((passed_s * slow - 0.001) * NS_PER_S), true_ns + MILLISECOND)
    assert clock.state in (ClockState.BEHIND, ClockState.WRONG)
    assert clock.edge_s > 0.02


@pytest.mark.parametrize("rate", [5, 20, 200])
@pytest.mark.parametrize("period_s", [0.5, 1.0, 2.0, 5.0, 10.0, 30.0])
def test_a_clock_that_runs_slow_and_is_set_again_and_again_is_behind(
    period_s: float, rate: int
) -> None:
    clock = PublisherClock()
    for number in range(60 * rate):
        passed_s = number / rate
        true_ns = NOW_NS + round(passed_s * NS_PER_S)
        late_s = 0.1 * (passed_s % period_s) / period_s
        clock.observe(true_ns - round(late_s * NS_PER_S), true_ns + MILLISECOND)
        if passed_s > 40.0 and period_s <= 10.0:
            assert clock.state is ClockState.BEHIND
            assert 0.06 < clock.edge_s < 0.11
        if abs(passed_s - 25.0) < 0.1:
            # Half of its measurements come when it is right, and say nothing of the rest.
            clock.take_offset(Offset(-late_s - 0.001, -late_s + 0.001))
            if late_s > WAY_S + 0.001:
                assert clock.state is ClockState.WRONG
                return
    assert clock.state is ClockState.BEHIND


def test_a_clock_that_was_behind_is_trusted_when_most_messages_come_in_time_again() -> None:
    clock = observed(5.0, 0.001)
    for number, late_s in enumerate([0.1] * 1500 + [0.001] * 1200):
        stamp_ns = NOW_NS + 5 * NS_PER_S + number * PERIOD_NS
        clock.observe(stamp_ns, stamp_ns + round(late_s * NS_PER_S))
        if number in (1499, 1600):
            assert clock.state is ClockState.BEHIND
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


@pytest.mark.parametrize("rate", [5, 20])
@pytest.mark.parametrize("step_s", [0.25, 0.5, 0.9, 4.0])
def test_a_stamp_that_steps_back_shows_at_once_that_the_clock_was_set(
    step_s: float, rate: int
) -> None:
    clock = observed(5.0, 0.001)
    clock.take_offset(Offset(-0.001, 0.001))
    true_ns = NOW_NS + 5 * NS_PER_S + NS_PER_S // rate
    clock.observe(true_ns - round(step_s * NS_PER_S), true_ns)
    assert clock.state is (ClockState.BEHIND if step_s < BEHIND_S else ClockState.WRONG)
    assert clock.edge_s == pytest.approx(step_s, abs=0.002)


@pytest.mark.parametrize("rate", [0.5, 1])
@pytest.mark.parametrize("period_s", [20.0, 45.0])
def test_a_sawtooth_of_half_a_second_is_noticed_on_a_topic_that_is_slow(
    period_s: float, rate: float
) -> None:
    clock = PublisherClock()
    wrong_s: list[float] = []
    for number in range(round(300 * rate)):
        passed_s = number / rate
        true_ns = NOW_NS + round(passed_s * NS_PER_S)
        late_s = 0.5 * (passed_s % period_s) / period_s
        clock.observe(true_ns - round(late_s * NS_PER_S), true_ns + MILLISECOND)
        if clock.state is ClockState.SYNCHRONISED and late_s > WAY_S + 0.005:
            wrong_s.append(passed_s)
    # Not after the clock was set for the second time.
    assert max(wrong_s) < 2 * period_s + 10 / rate
    assert clock.state is ClockState.BEHIND


@pytest.mark.parametrize("rate", [0.5, 1, 2])
@pytest.mark.parametrize("slow", [0.005, 0.01, 0.025])
def test_a_clock_that_begins_to_run_slow_is_noticed_after_four_late_messages(
    slow: float, rate: float
) -> None:
    clock, chance = PublisherClock(), random.Random(4)
    believed = 0
    for number in range(round(60 * rate)):
        passed_s = number / rate
        true_ns = NOW_NS + round(passed_s * NS_PER_S)
        late_s = slow * max(0.0, passed_s - 20)
        arrival_ns = true_ns + MILLISECOND + round(chance.uniform(0, 2) * MILLISECOND)
        clock.observe(true_ns - round(late_s * NS_PER_S), arrival_ns)
        believed += late_s > WAY_S and clock.state is ClockState.SYNCHRONISED
    assert clock.state is ClockState.BEHIND
    assert believed <= 3 + 2 * (rate > 1)


@pytest.mark.parametrize("begin_s", [0, 7, 20])
@pytest.mark.parametrize("rate", [1, 20])
def test_the_edge_of_a_clock_that_is_set_again_and_again_is_never_ahead(
    rate: int, begin_s: float
) -> None:
    clock = PublisherClock()
    for number in range(200 * rate):
        passed_s = number / rate
        true_ns = NOW_NS + round(passed_s * NS_PER_S)
        late_s = 0.5 * ((passed_s + begin_s) % 30) / 30
        clock.observe(true_ns - round(late_s * NS_PER_S), true_ns + MILLISECOND)
        assert clock.edge_s > 0


@pytest.mark.parametrize("share", [0.1, 0.3, 0.45])
def test_a_clock_that_is_set_to_and_fro_is_not_called_synchronised(share: float) -> None:
    clock = PublisherClock()
    for number in range(60 * 20):
        passed_s = number / 20
        true_ns = NOW_NS + round(passed_s * NS_PER_S)
        late_s = 0.3 * (passed_s % 10 > 10 * (1 - share))
        clock.observe(true_ns - round(late_s * NS_PER_S), true_ns + MILLISECOND)
        if late_s:
            assert clock.state is ClockState.BEHIND
    assert clock.state is ClockState.BEHIND


@pytest.mark.parametrize("rate", [0.5, 1, 2, 5])
@pytest.mark.parametrize("late_s", [0.05, 0.3, 0.9])
@pytest.mark.parametrize("share", [0.2, 0.45])
def test_a_clock_that_is_behind_at_times_is_noticed_on_a_topic_that_is_slow(
    rate: float, late_s: float, share: float
) -> None:
    clock = PublisherClock()
    wrong = 0
    for number in range(round(240 * rate)):
        passed_s = number / rate
        true_ns = NOW_NS + round(passed_s * NS_PER_S)
        is_late = passed_s % 40 > 40 * (1 - share)
        jitter_ns = number % 3 * MILLISECOND
        clock.observe(
            true_ns - round(late_s * is_late * NS_PER_S), true_ns + MILLISECOND + jitter_ns
        )
        wrong += is_late and clock.state is ClockState.SYNCHRONISED
    assert clock.state is ClockState.BEHIND
    # Until it was noticed, twice.
    assert wrong <= 2 * max(3, 2 * rate + 1)


@pytest.mark.parametrize("rate", [0.5, 1, 5])
def test_messages_of_a_slow_topic_that_come_late_by_the_way_are_forgiven(rate: float) -> None:
    clock, chance = PublisherClock(), random.Random(rate)
    for number in range(round(600 * rate)):
        stamp_ns = NOW_NS + round(number / rate * NS_PER_S)
        late_s = chance.expovariate(20) if chance.random() < 0.1 else 0.001
        clock.observe(stamp_ns, stamp_ns + round(late_s * NS_PER_S))
    assert clock.state is ClockState.SYNCHRONISED


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


# What answers say of the clock of who answered.
def answer(sent_ms: float, came_ms: float) -> tuple[int, int]:
    return NOW_NS + round(sent_ms * MILLISECOND), NOW_NS + round(came_ms * MILLISECOND)


def test_answers_bound_a_clock_from_both_sides() -> None:
    bounds = Bounds()
    assert bounds.offset is None
    # Asked at 0, sent 4 ms later by a clock that is 500 ms behind.
    bounds.take(NOW_NS, *answer(-496, 5))
    assert bounds.offset == Offset(-0.501, -0.496)
    bounds.take(NOW_NS, *answer(-498, 20))
    assert bounds.offset == Offset(-0.501, -0.498)


def test_a_clock_that_was_set_in_between_is_not_measured() -> None:
    bounds = Bounds()
    bounds.take(NOW_NS, *answer(-496, 5))
    bounds.take(NOW_NS, *answer(4, 5))
    assert bounds.answers == 2
    assert bounds.offset is None


def test_an_answer_without_stamps_says_nothing() -> None:
    bounds = Bounds()
    bounds.take(NOW_NS, 0, 0)
    assert bounds.answers == 0


# Which time a message gets, and that it is the right one on LSL's clock.
MakeNode = Callable[..., Node]


@pytest.fixture
def ros_time(make_node: MakeNode) -> RosTime:
    return RosTime(make_node("stamping"))


@pytest.mark.nightly
def test_a_header_comes_first_then_the_source_then_the_arrival(ros_time: RosTime) -> None:
    stamping = MessageStamping(ros_time, has_header=True, by_arrival=False)
    now = time.time_ns()
    told = info(now)
    assert stamping.expected is StampSource.HEADER
    assert stamping.stamp(stamped(JointState(), now), told).source is StampSource.HEADER
    assert stamping.stamp(JointState(), told).source is StampSource.SOURCE
    nothing = info(0, now)
    assert stamping.stamp(JointState(), nothing).source is StampSource.ARRIVAL
    assert list(stamping.sources.values()) == [1, 1, 1]


@pytest.mark.nightly
def test_text_has_no_header(ros_time: RosTime) -> None:
    stamping = MessageStamping(ros_time, has_header=False, by_arrival=False)
    assert stamping.expected is StampSource.SOURCE
    assert stamping.choose(String(), info(time.time_ns())) is StampSource.SOURCE


@pytest.mark.nightly
def test_arrival_alone_can_be_asked_for(ros_time: RosTime) -> None:
    stamping = MessageStamping(ros_time, has_header=True, by_arrival=True)
    # As simulated time would have it.
    message = stamped(JointState(), 12 * NS_PER_S)
    told = info(time.time_ns())
    stamping.observe(message, told)
    assert stamping.choose(message, told) is StampSource.ARRIVAL
    assert not stamping.doubtful_clocks


@pytest.mark.nightly
def test_a_wall_time_becomes_the_lsl_time_of_that_moment(ros_time: RosTime) -> None:
    stamping = MessageStamping(ros_time, has_header=True, by_arrival=False)
    before = pylsl.local_clock()
    message = stamped(JointState(), time.time_ns())
    after = pylsl.local_clock()
    lsl_s = stamping.stamp(message, info(time.time_ns())).lsl_s
    assert before - 5e-5 < lsl_s < after + 5e-5


@pytest.mark.nightly
@pytest.mark.parametrize("wrong_s", [-3600.0, 12.0, 300_000_000.0])
def test_stamps_of_a_wrong_clock_are_not_used(ros_time: RosTime, wrong_s: float) -> None:
    stamping = MessageStamping(ros_time, has_header=True, by_arrival=False)
    now = time.time_ns()
    message, told = JointState(), info(now)
    for number in range(400):
        at = now + number * 10 * MILLISECOND
        message = stamped(JointState(), max(1, at + round(wrong_s * NS_PER_S)))
        told = info(at)
        stamping.observe(message, told)
    assert stamping.choose(message, told) is StampSource.SOURCE
    (found,) = stamping.doubtful_clocks.items()
    assert (found[0], found[1].is_used) == (StampSource.HEADER, False)
    assert found[1].edge_s == pytest.approx(-wrong_s, abs=0.01)


@pytest.mark.nightly
def test_a_computer_whose_clock_is_wrong_is_stamped_by_arrival(ros_time: RosTime) -> None:
    stamping = MessageStamping(ros_time, has_header=True, by_arrival=False)
    now = time.time_ns()
    message, told = stamped(JointState(), now), info(now, -NS_PER_S)
    stamping.observe(message, told)
    stamp = stamping.stamp(message, told)
    assert stamp.source is StampSource.ARRIVAL
    assert stamping.doubtful_clocks.keys() == {StampSource.HEADER, StampSource.SOURCE}
    # The own clock was set: all is judged again.
    stamping.restart()
    assert not stamping.doubtful_clocks


@pytest.mark.parametrize("has_header", [True, False])
@pytest.mark.parametrize("offsets_s", [(0.0, -0.3), (-0.3, 0.0), (0.0, -5.0), (-0.05, -0.7, 0.0)])
def test_of_several_publishers_no_wrong_clock_hides_behind_a_right_one(
    offsets_s: tuple[float, ...], has_header: bool
) -> None:
    # Which time is chosen needs no clock of ROS.
    stamping = MessageStamping(cast("RosTime", None), has_header=has_header, by_arrival=False)
    stamping.is_mixed = True
    for number in range(400):
        offset_s = offsets_s[number % len(offsets_s)]
        sent_ns = NOW_NS + number * 10 * MILLISECOND
        own_ns = sent_ns + round(offset_s * NS_PER_S)
        message = stamped(JointState(), own_ns) if has_header else String()
        told = info(own_ns, sent_ns + MILLISECOND - own_ns)
        stamping.observe(message, told)
        if not stamping.is_in_doubt:
            by_arrival = stamping.choose(message, told) is StampSource.ARRIVAL
            assert by_arrival == (offset_s != 0)
    worst = stamping.doubtful_clocks[StampSource.SOURCE]
    assert worst.edge_s == pytest.approx(-min(offsets_s), abs=0.01)
    assert "of its several publishers" in doubt_of(StampSource.SOURCE, worst)


@pytest.mark.nightly
def test_stamps_never_run_back(ros_time: RosTime) -> None:
    stamping = MessageStamping(ros_time, has_header=True, by_arrival=False)
    now = time.time_ns()
    stamps = [
        stamping.stamp(stamped(JointState(), at), info(now)).lsl_s
        for at in (now, now - MILLISECOND, now + MILLISECOND)
    ]
    assert stamps == sorted(stamps)
    assert len(set(stamps)) == 3
    assert stamping.moved == 1


def test_missing_numbers_are_messages_that_were_lost() -> None:
    losses = PublicationLosses()
    for number in (5, 6, 9, 10):
        losses.take(number)
    assert losses.lost == 0
    assert losses.look(publishers=1) == 2
    # A publisher that was started again counts from the beginning.
    losses.take(1)
    losses.take(2)
    assert losses.look(publishers=1) == 0
    assert losses.lost == 2


def test_with_two_publishers_nobody_knows_what_was_lost() -> None:
    losses = PublicationLosses()
    for number in (5, 100, 6, 101):
        losses.take(number)
    assert losses.look(publishers=2) == 0
    assert losses.lost is None
    assert losses.look(publishers=1) == 0
    assert losses.lost is None


def test_without_numbers_nobody_knows() -> None:
    losses = PublicationLosses()
    losses.take(None)
    assert losses.lost is None


def test_a_clock_that_is_right_again_is_doubted_no_more() -> None:
    refusals = Refusals()
    doubts = Doubts(refusals)
    doubts.tell({StampSource.SOURCE: Doubt(ClockState.WRONG, 0.3, None, is_used=False)})
    assert [each.what for each in refusals.present] == [Refusal.DOUBTFUL_CLOCK]
    doubts.tell({})
    assert not refusals.present


@pytest.mark.parametrize(("late_s", "may_be"), [(1_796_000_000.0, True), (5.0, False)])
def test_headers_of_simulated_time_are_told_as_such(late_s: float, may_be: bool) -> None:
    doubt = Doubt(ClockState.WRONG, late_s, None, is_used=False)
    assert ("use_sim_time" in doubt_of(StampSource.HEADER, doubt)) is may_be
    assert "use_sim_time" not in doubt_of(StampSource.SOURCE, doubt)
