"""A robot whose time of day may be shifted; each message carries the true monotonic time.

    python -m tests.rigs.shifted_publisher [deaf]

`deaf` answers nobody: it has no services for its parameters.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.node import Node

PERIOD_S = 0.05


def main() -> None:
    """Publish until the process is ended."""
    rclpy.init()
    node = Node("shifted", start_parameter_services="deaf" not in sys.argv)
    pose = node.create_publisher(PoseStamped, "/pose", 10)
    velocity = node.create_publisher(Twist, "/vel", 10)

    def publish() -> None:
        # Their own annotations are partial.
        message: Any = PoseStamped()
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(time.time_ns(), 10**9)
        message.pose.position.y = time.monotonic()
        pose.publish(message)
        other: Any = Twist()
        other.linear.y = time.monotonic()
        velocity.publish(other)

    node.create_timer(PERIOD_S, publish)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
