"""``python -m tests.system.listener TYPE TOPIC [TYPE TOPIC ...]``: print messages as JSON.

Each is an object on a line of its own, ``topic`` and ``message``, in the order of arrival.
The last message that a topic has kept for later subscribers is asked for where the TYPE
ends in ``@latched``. It listens until it is killed.
"""

from __future__ import annotations

import json
import sys
from functools import partial
from importlib import import_module
from typing import Any

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile

from tests.system.message_fields import fields_of, message_class

# It is not in the part of rclpy that this project's stubs describe, and costs a quarter of
# the usual one.
_executors: Any = import_module("rclpy.experimental")

QUEUE = 10_000
LATCHED = "@latched"


def _print(topic: str, message: Any) -> None:
    print(json.dumps({"topic": topic, "message": fields_of(message)}), flush=True)


def main() -> None:
    words = sys.argv[1:]
    rclpy.init(args=[])
    node = rclpy.create_node("listener")
    for kind, topic in zip(words[::2], words[1::2], strict=True):
        latched = kind.endswith(LATCHED)
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        node.create_subscription(
            message_class(kind.removesuffix(LATCHED)),
            topic,
            partial(_print, topic),
            QoSProfile(depth=QUEUE, durability=durability),
        )
    executor = _executors.EventsExecutor()
    executor.add_node(node)
    while rclpy.ok():
        executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    main()
