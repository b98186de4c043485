"""Which time a message gets, and that it is the right one on LSL's clock."""

from __future__ import annotations

import time
from collections.abc import Callable

import pylsl
import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from biosensor_common.ros_clock import NS_PER_S
from lsl_to_ros.ros_to_lsl.bridge import PublicationLosses
from lsl_to_ros.ros_to_lsl.stamps import MessageStamping, StampSource
from lsl_to_ros.statistics.ros_time import RosTime
from tests.ros_to_lsl.conftest import MILLISECOND, info, stamped

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
