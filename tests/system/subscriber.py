"""``python -m tests.system.subscriber TYPE TOPIC``: print every message as a line of JSON.

It listens until it is killed.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile

from tests.system.message_fields import fields_of, message_class

QUEUE = 10_000


def _print(fields: dict[str, Any]) -> None:
    print(json.dumps(fields), flush=True)


def main() -> None:
    name, topic = sys.argv[1:]
    rclpy.init(args=[])
    node = rclpy.create_node("subscriber")

    def take(message: Any) -> None:
        _print(fields_of(message))

    node.create_subscription(message_class(name), topic, take, QoSProfile(depth=QUEUE))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while rclpy.ok():
        executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    main()
