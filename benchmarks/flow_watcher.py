"""Waits for topics to flow again: ``python -m benchmarks.flow_watcher TOPIC...``.

The order NUMBER has it say ``flows`` and when there has been a sample of that number on
every topic.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from functools import partial

import rclpy

from benchmarks import ros_executor
from benchmarks.child import Orders, say
from benchmarks.ros_receiver import subscribe_raw
from benchmarks.wire import ArrayReader


class Watcher:
    """Looks at each sample's number."""

    def __init__(self, topics: Sequence[str], orders: Orders) -> None:
        self._orders = orders
        self._topics = frozenset(topics)
        self._awaited = set[str]()
        self._number = 0.0

    def take(self, topic: str, reader: ArrayReader, message: bytes) -> None:
        """Note a message of that topic."""
        now = time.monotonic()
        order = self._orders.poll()
        if order is not None:
            self._number, self._awaited = float(order), set(self._topics)
        if topic in self._awaited and reader.first_value(message) == self._number:
            self._awaited.remove(topic)
            if not self._awaited:
                say(f"flows {now}")


def watch(topics: Sequence[str]) -> None:
    """Watch until the parent closes the pipe."""
    orders, node = Orders(), rclpy.create_node("bench_flow_watcher")
    watcher = Watcher(topics, orders)
    for topic in topics:
        subscribe_raw(node, topic, partial(watcher.take, topic, ArrayReader()))
    ros_executor.spin(ros_executor.events_executor(node), orders)


if __name__ == "__main__":
    rclpy.init()
    watch(sys.argv[1:])
    rclpy.shutdown()
