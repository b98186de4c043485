"""A subscriber as tutorials show it, in a process of its own.

    python -m tests.rigs.tutorial_subscriber DEPTH reliable|best_effort [TOPIC TYPE]...

TYPE is as ROS writes it. Without topics it subscribes to all under ``/biosensors/`` that it
finds, but not to chunks. A line of its standard input is answered by one of JSON: how many
messages came on each topic and, of those that hold a number, the numbers.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

_PREFIX, _LOOK_S = "/biosensors/", 0.5


class Tutorial(Node):
    """Subscribes with a callback for each topic, and notes what comes."""

    def __init__(self, qos: QoSProfile, topics: Sequence[str]) -> None:
        super().__init__("tutorial")
        self.heard: dict[str, list[Any]] = {}
        self._qos = qos
        for topic, kind in zip(topics[::2], topics[1::2], strict=True):
            self._subscribe(topic, kind)
        if not topics:
            self._look()
            self.create_timer(_LOOK_S, self._look)

    def _look(self) -> None:
        for topic, (kind, *_) in self.get_topic_names_and_types():
            if topic.startswith(_PREFIX) and not topic.endswith("_chunk"):
                self._subscribe(topic, kind)

    def _subscribe(self, topic: str, kind: str) -> None:
        if topic not in self.heard:
            package, _, name = kind.split("/")
            message_class = getattr(import_module(f"{package}.msg"), name)
            self.heard[topic] = []
            self.create_subscription(message_class, topic, self._callback(topic), self._qos)

    def _callback(self, topic: str) -> Callable[[Any], None]:
        heard = self.heard[topic]

        def callback(message: Any) -> None:
            value = getattr(message, "data", None)
            heard.append(value if isinstance(value, float) else None)

        return callback


def _answer(node: Tutorial) -> None:
    for _ in sys.stdin:
        print(json.dumps({topic: list(values) for topic, values in node.heard.items()}), flush=True)
    # Nothing is left to be done, and spin ends only by a signal.
    os._exit(0)


def main() -> None:
    """Spin until standard input ends."""
    depth, reliability, *topics = sys.argv[1:]
    rclpy.init(args=[])
    policy = ReliabilityPolicy[reliability.upper()]
    node = Tutorial(QoSProfile(depth=int(depth), reliability=policy), topics)

    threading.Thread(target=_answer, args=(node,), daemon=True).start()
    rclpy.spin(node)


if __name__ == "__main__":
    main()
