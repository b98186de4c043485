"""Subscribers in one process; its argument is a `Subscription` as JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float32MultiArray

from benchmarks import ros_executor
from benchmarks.child import Orders, say
from benchmarks.samples import RATE_HZ, Arrivals
from benchmarks.wire import ArrayReader


@dataclass(frozen=True, slots=True)
class Subscription:
    """What one process subscribes to."""

    topics: Sequence[str]
    count: int  # Numbered samples that come on each topic.
    file: str  # Where the times of arrival go, shape [topics, count].
    # Whether as most programs do it: deserialised, by the usual executor. Else for little CPU.
    usual: bool = False
    chunks: bool = False  # Whether a message has many samples; not with *usual*.

    def as_arguments(self) -> list[str]:
        """Return the arguments that start the process."""
        return ["benchmarks.ros_receiver", json.dumps(asdict(self))]


def subscribe_raw(node: Node, topic: str, callback: Callable[[bytes], None]) -> None:
    """Subscribe to an array without deserialising it."""
    create: Any = node.create_subscription
    create(Float32MultiArray, topic, callback, QoSProfile(depth=int(RATE_HZ)), raw=True)


class Receiver:
    """Notes what arrives.

    Says ``connected`` when something came on every topic, and then ``complete`` when all
    numbers did.
    """

    def __init__(self, node: Node, subscription: Subscription) -> None:
        self.arrivals = Arrivals(len(subscription.topics), subscription.count)
        self._awaited = set(range(len(subscription.topics)))
        self._is_complete = False
        for index, topic in enumerate(subscription.topics):
            if subscription.usual:
                depth, take = QoSProfile(depth=int(RATE_HZ)), partial(self._take, index)
                node.create_subscription(Float32MultiArray, topic, take, depth)
            else:
                take = self._take_chunk if subscription.chunks else self._take_bytes
                subscribe_raw(node, topic, partial(take, index, ArrayReader()))

    def _take(self, index: int, message: Float32MultiArray) -> None:
        self.arrivals.add(index, message.data[0])
        self._note(index)

    def _take_bytes(self, index: int, reader: ArrayReader, message: bytes) -> None:
        self.arrivals.add(index, reader.first_value(message))
        self._note(index)

    def _take_chunk(self, index: int, reader: ArrayReader, message: bytes) -> None:
        self.arrivals.add_chunk(index, reader.first_channel(message))
        self._note(index)

    def _note(self, index: int) -> None:
        if index in self._awaited:
            self._awaited.remove(index)
            if not self._awaited:
                say("connected")
        if not self._is_complete and not self._awaited and self.arrivals.is_complete:
            self._is_complete = True
            say("complete")


def receive(subscription: Subscription) -> None:
    """Take messages until the parent closes the pipe."""
    orders, node = Orders(), rclpy.create_node("bench_receiver")
    receiver = Receiver(node, subscription)
    executor_of = (
        ros_executor.usual_executor if subscription.usual else ros_executor.events_executor
    )
    ros_executor.spin(executor_of(node), orders)
    receiver.arrivals.write(Path(subscription.file))
    say(f"repeated {receiver.arrivals.repeated}")


if __name__ == "__main__":
    rclpy.init()
    receive(Subscription(**json.loads(sys.argv[1])))
    rclpy.shutdown()
