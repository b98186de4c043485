"""A subscriber whose callback takes its time, as a plot's or a slow model's does.

    python -m tests.faults.scenarios.slow_subscriber TOPIC

Reliable and with a deep queue, of ``std_msgs/Float32``. Steered: ``sleep`` has each
callback take so many ``seconds`` from now on; ``state`` tells how many messages came;
``save`` writes them to ``path``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float32

from tests.rigs.hosts import completeness
from tests.rigs.hosts.programs import Dialogue
from tests.rigs.hosts.subscriber import DEPTH, Topic

LOOK_S = 0.05


class SlowSubscriber:
    """Takes one message at a time, and sleeps."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._topic = Topic(Float32)
        self._sleep_s = 0.0

    def take(self, message: bytes) -> None:
        self._topic.take(message)
        if self._sleep_s:
            time.sleep(self._sleep_s)

    def obey(self, command: Mapping[str, Any]) -> Any:
        match command["do"]:
            case "sleep":
                self._sleep_s = float(command["seconds"])
                return None
            case "state":
                return {"received": {self._name: len(self._topic.messages)}}
            case "save":
                completeness.save(Path(command["path"]), {self._name: self._topic.recording()})
                return None
            case other:
                raise ValueError(f"what is {other!r}?")


def main() -> None:
    name = sys.argv[1]
    rclpy.init(args=None)
    node: Any = rclpy.create_node("slow_subscriber")
    subscriber = SlowSubscriber(name)
    profile = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)
    node.create_subscription(Float32, name, subscriber.take, profile, raw=True)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    dialogue = Dialogue()
    while not dialogue.ended:
        executor.spin_once(timeout_sec=LOOK_S)
        dialogue.answer(subscriber.obey)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
