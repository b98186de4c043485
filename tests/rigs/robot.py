"""A robot for tests: ``python -m tests.rigs.robot FILE``, until SIGINT.

It publishes joints, odometry, a wrench and text. Each message has its number, from 0, in it; the
file then tells for each topic when each was published, in nanoseconds since 1970.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from array import array
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from lsl_to_ros.ros_to_lsl.fields import message_class

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
