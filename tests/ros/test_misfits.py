"""Subscribers that get nothing of a topic, as DDS tells of them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float32

from tests.rigs.recorded_topics import RecordedPublisher

USUAL = QoSProfile(depth=10)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
ENDLESS = Duration(seconds=9223372036, nanoseconds=854775807)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def misfit(
    offered: QoSProfile, asked: QoSProfile, kind: str = "std_msgs/msg/Float32", where: str = "/"
) -> str:
    topic = RecordedPublisher(Float32)
    publisher: Any = topic.ros_publisher
    publisher.qos_profile = offered
    reader: Any = SimpleNamespace(
        node_name="client", node_namespace=where, topic_type=kind, qos_profile=asked
    )
    return topic.misfit(reader)


@pytest.mark.parametrize(
    ("offered", "asked"), [(USUAL, USUAL), (USUAL, BEST_EFFORT), (LATCHED, USUAL)]
)
def test_who_asks_for_no_more_than_there_is_fits(offered: QoSProfile, asked: QoSProfile) -> None:
    assert misfit(offered, asked) == ""


def test_another_type_is_named() -> None:
    told = misfit(USUAL, USUAL, "std_msgs/msg/Int32", "/robot")
    assert told == "/robot/client reads it as std_msgs/msg/Int32, and it is std_msgs/msg/Float32"


@pytest.mark.parametrize(
    ("offered", "asked", "expected"),
    [
        (USUAL, LATCHED, "volatile and not transient_local"),
        (BEST_EFFORT, USUAL, "best_effort and not reliable"),
        (
            BEST_EFFORT,
            LATCHED,
            "best_effort and not reliable and volatile and not transient_local",
        ),
    ],
)
def test_what_is_asked_for_and_not_offered_is_named(
    offered: QoSProfile, asked: QoSProfile, expected: str
) -> None:
    assert misfit(offered, asked) == f"it is {expected}, as /client wants it"


def test_what_dds_says_of_deadlines_is_no_misfit() -> None:
    # An endless one, which nobody has asked for.
    endless = QoSProfile(depth=10, deadline=ENDLESS, liveliness_lease_duration=ENDLESS)
    assert misfit(USUAL, endless) == ""
