"""Stamps of a sender become ROS times, or are known to be none."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

import numpy as np
import pylsl
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from tests.rigs.recorded_topics import Clocks

if TYPE_CHECKING:
    from tests.ros.conftest import Ros

pytestmark = pytest.mark.nightly

STAMPS = [
    *(0.0, 1.0, 12345.678901234, -1.0, -1e5, 1e5, 3e8),
    *(2.0**31, -(2.0**31), 3e9, 1.7e12, 1.7e18, 9.3e18, 1e300, -1e300),
    *(math.nan, math.inf, -math.inf),
]


def nanoseconds(clocks: Clocks, stamp: float) -> int:
    (found,) = clocks.to_ns(np.array([stamp])).tolist()
    return found


def test_now_is_now(ros: Ros) -> None:
    offset = 1234.5
    clocks = Clocks(ros.node, offset)
    before = time.time_ns()
    stamp = pylsl.local_clock() - offset
    after = time.time_ns()
    # As exact as the offset of the two clocks is measured, see test_ros_clock.
    tolerance_ns = 1_000_000
    assert before - tolerance_ns <= nanoseconds(clocks, stamp) <= after + tolerance_ns


def test_the_distance_of_two_stamps_is_kept(ros: Ros) -> None:
    clocks = Clocks(ros.node, 0.25)
    start = nanoseconds(clocks, 1000.0)
    for step in (1, 3, 1024, 10**6):
        distance = nanoseconds(clocks, 1000.0 + step / 1024) - start
        assert abs(distance - step * 1e9 / 1024) <= 1


@pytest.mark.parametrize("stamp", STAMPS)
def test_what_is_said_to_be_a_time_is_one(ros: Ros, stamp: float) -> None:
    clocks = Clocks(ros.node, 12.5)
    (is_time,) = clocks.are_times(np.array([stamp]))
    since_1970 = time.time() - pylsl.local_clock() + 12.5 + stamp
    assert bool(is_time) is bool(0 <= since_1970 < 2**31)
    if is_time:
        assert nanoseconds(clocks, stamp) / 1e9 == pytest.approx(since_1970, abs=1.0)


def test_many_are_judged_at_once(ros: Ros) -> None:
    clocks = Clocks(ros.node, 12.5)
    singly = [bool(clocks.are_times(np.array([stamp]))[0]) for stamp in STAMPS]
    assert clocks.are_times(np.array(STAMPS)).tolist() == singly
    assert True in singly
    assert False in singly


def test_nothing_is_said_before_the_senders_clock_is_known(ros: Ros) -> None:
    clocks = Clocks(ros.node, None)
    assert not clocks.is_known
    with pytest.raises(ValueError, match="clock"):
        clocks.to_ns(np.array([1.0]))
    with pytest.raises(ValueError, match="clock"):
        clocks.local(1.0)
    with pytest.raises(ValueError, match="clock"):
        clocks.are_times(np.array([1.0]))
    clocks.correction = 2.0
    assert clocks.is_known
    assert clocks.local(1.0) == 3.0


def test_in_simulated_time_a_sample_has_the_time_of_its_receipt(ros: Ros) -> None:
    assert ros is not None
    node = Node("simulated", parameter_overrides=[Parameter("use_sim_time", value=True)])
    clocks = Clocks(node, 0.0)
    # No clock has been published.
    assert nanoseconds(clocks, 5.0) == nanoseconds(clocks, 1e300) == 0
    judged = clocks.are_times(np.array([5.0, 1e300, math.nan]))
    assert judged.tolist() == [True, True, False]
    node.destroy_node()
