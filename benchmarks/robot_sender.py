"""A robot's joints on many topics: ``python -m benchmarks.robot_sender TOPICS RATE``.

Now and then a message until its parent says a line, then nothing until the next one, then all at
their rate until one more; then it says how many these were.
"""

from __future__ import annotations

import sys
import time
from array import array

import rclpy
from rclpy.qos import QoSProfile

from benchmarks.child import Orders, say
from lsl_to_ros.ros_to_lsl.class_fields import message_class

# Their own annotations are partial.
JointState = message_class("sensor_msgs/msg/JointState")

JOINTS = [f"panda_joint{number}" for number in range(1, 8)]
_SLOW_S = 0.2


def topic_of(number: int) -> str:
    """Return the name of a topic."""
    return f"/bench/joints_{number}"


def run(topics: int, rate_hz: float) -> None:
    """Publish, a topic after the other, evenly spread over the period."""
    node = rclpy.create_node("bench_robot")
    quality = QoSProfile(depth=100)
    publishers = [
        node.create_publisher(JointState, topic_of(number), quality) for number in range(topics)
    ]
    message = JointState(name=JOINTS)
    message.position = message.velocity = message.effort = array("d", [0.1] * len(JOINTS))

    def publish(number: int) -> None:
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
        publishers[number % topics].publish(message)

    orders = Orders()
    while orders.poll() is None:
        for number in range(topics):
            publish(number)
        time.sleep(_SLOW_S)
    say("resting")
    while orders.poll() is None:
        time.sleep(_SLOW_S)
    begin, published = time.monotonic(), 0
    while orders.poll() is None and not orders.closed.is_set():
        wait_s = begin + published / (topics * rate_hz) - time.monotonic()
        if wait_s > 0:
            time.sleep(wait_s)
        publish(published)
        published += 1
    say(f"published {published}")
    orders.closed.wait()


if __name__ == "__main__":
    rclpy.init()
    run(int(sys.argv[1]), float(sys.argv[2]))
    rclpy.shutdown()
