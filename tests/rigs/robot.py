"""A robot for tests: ``python -m tests.rigs.robot FILE``, until SIGINT.

It publishes joints, odometry, a wrench and text. Each message has its number, from 0, in it; the
file then tells for each topic when each was published, in nanoseconds since 1970.
"""

from __future__ import annotations

import json
import re
import signal
import sys
import threading
import time
from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from lsl_to_ros.ros_to_lsl.class_fields import message_class

# Their own annotations are partial.
WrenchStamped = message_class("geometry_msgs/msg/WrenchStamped")
Odometry = message_class("nav_msgs/msg/Odometry")
JointState = message_class("sensor_msgs/msg/JointState")
String = message_class("std_msgs/msg/String")

JOINTS = [f"panda_joint{number}" for number in range(1, 8)]
RELIABLE = QoSProfile(depth=100)
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
# So long after its node is there a robot begins; whoever listens has found it by then.
BEGIN_S = 3.0


class Part(NamedTuple):
    """A topic of the robot."""

    topic: str
    kind: type[Any]
    quality: QoSProfile
    rate_hz: float
    fill: Callable[[Any, int], None]


def _joints(message: Any, number: int) -> None:
    message.name = JOINTS
    message.position = array("d", [number + place / 10 for place in range(7)])
    message.velocity = array("d", [0.5] * 7)


def _odometry(message: Any, number: int) -> None:
    message.header.frame_id, message.child_frame_id = "odom", "base_link"
    message.pose.pose.position.x = float(number)


def _wrench(message: Any, number: int) -> None:
    message.wrench.force.z = float(number)


def _event(message: Any, number: int) -> None:
    message.data = f"step {number}"


PARTS = (
    Part("/joint_states", JointState, RELIABLE, 100, _joints),
    Part("/odom", Odometry, BEST_EFFORT, 50, _odometry),
    Part("/wrench", WrenchStamped, BEST_EFFORT, 500, _wrench),
    Part("/robot/event", String, RELIABLE, 2, _event),
)


def run(node: Node, stopping: threading.Event) -> dict[str, list[int]]:
    """Publish everything at its rate until told to stop; return the stamps of each topic."""
    publishers = [node.create_publisher(each.kind, each.topic, each.quality) for each in PARTS]
    stopping.wait(BEGIN_S)
    stamps: dict[str, list[int]] = {each.topic: [] for each in PARTS}
    begin = time.monotonic()
    while not stopping.wait(0.0005):
        passed = time.monotonic() - begin
        for each, publisher in zip(PARTS, publishers, strict=True):
            sent = stamps[each.topic]
            while len(sent) <= passed * each.rate_hz:
                message = each.kind()
                each.fill(message, len(sent))
                now_ns = time.time_ns()
                if hasattr(message, "header"):
                    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 10**9)
                sent.append(now_ns)
                publisher.publish(message)
    return stamps


def main() -> None:
    """Publish until SIGINT, then write the file."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    stopping = threading.Event()

    def stop(_number: int, _frame: FrameType | None) -> None:
        stopping.set()

    signal.signal(signal.SIGINT, stop)
    robot = rclpy.create_node("robot")
    Path(sys.argv[1]).write_text(json.dumps(run(robot, stopping)))
    robot.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()


Stream = dict[str, Any]

# LabRecorder does not write what comes in its last half second, and the node may be held up.
UNWRITTEN_S = 2.5
# What comes over these may be lost on the way, to a node that is held up.
MAY_LOSE = {
    each.topic for each in PARTS if each.quality.reliability is ReliabilityPolicy.BEST_EFFORT
}
# Stream, and the channel that counts its messages.
_COUNTED = {
    "/joint_states": ("joint_states", "panda_joint1.position"),
    "/odom": ("odom", "pose.pose.position.x"),
    "/wrench": ("wrench", "wrench.force.z"),
}
_LOST = re.compile(r"(\S+): (\d+) messages were lost on the way")


def description(stream: Stream, group: str) -> Stream:
    """Return a group of a header's description."""
    return stream["info"]["desc"][0][group][0]


def labels(stream: Stream) -> list[str]:
    """Return one a channel."""
    return [each["label"][0] for each in description(stream, "channels")["channel"]]


def told_lost(log: str) -> Counter[str]:
    """Return by topic how many messages the node's log tells as lost on the way."""
    told = Counter[str]()
    for topic, count in _LOST.findall(log):
        told[topic] += int(count)
    return told


def greatest_errors_s(
    streams: Mapping[str, Stream],
    published: Mapping[str, list[int]],
    span: tuple[int, int],
    offset_s: float,
    lost: Mapping[str, int],
) -> dict[str, float]:
    """Return by topic how far the recorded stamps are off those that were published, at most.

    Every message that was published in the span must be there, once and in order. Of a topic
    that is best effort those may be missing which the node tells as lost.

    Parameters
    ----------
    streams
        By name.
    published
        By topic, as the robot tells it.
    span
        Begin and end, in nanoseconds since 1970.
    offset_s
        Time of day less the recording's.
    lost
        By topic, how many the node tells as lost since its start; see :func:`told_lost`.
    """
    worst_s: dict[str, float] = {}
    for topic, (name, label) in _COUNTED.items():
        stream, sent = streams[name], published[topic]
        column = labels(stream).index(label)
        numbers: list[int] = np.asarray(stream["time_series"])[:, column].astype(int).tolist()
        first, last = (next(n for n, at in enumerate(sent) if at > end) for end in span)
        assert all(one < next_ for one, next_ in pairwise(numbers)), topic
        wanted = range(min(first, numbers[0]), max(last, numbers[-1]) + 1)
        missing = len(wanted) - len(numbers)
        assert missing <= (lost.get(topic, 0) if topic in MAY_LOSE else 0), (topic, missing)
        sent_s = np.array([sent[number] for number in numbers]) / 1e9
        errors_s = np.asarray(stream["time_stamps"]) + offset_s - sent_s
        worst_s[topic] = float(np.abs(errors_s).max())
    return worst_s
