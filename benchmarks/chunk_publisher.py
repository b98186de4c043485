"""Times a full chunk: ``python -m benchmarks.chunk_publisher TOPIC FLOOR_TOPIC``."""

from __future__ import annotations

import json
import sys
import time
from array import array
from collections.abc import Callable

import numpy as np
import rclpy
from rclpy.serialization import serialize_message
from std_msgs.msg import Float32MultiArray

from benchmarks.child import Orders, say
from benchmarks.samples import CHANNELS, FILLER, values_of
from biosensor_common.quantities import MessageType
from lsl_to_ros.topics.lanes import Pace, Pacer
from lsl_to_ros.topics.publishers import TopicPublisher, TopicPublishers
from lsl_to_ros.topics.writers import ChunkWriter

SAMPLES = 1024
_PAUSE_S = 0.02


class Publisher:
    """Publishes chunks as the node does, and ready messages of the same size."""

    def __init__(self, port: TopicPublisher, floor: TopicPublisher) -> None:
        self._sample = np.array([values_of(FILLER)], dtype=np.float32)
        self._all_but_one = np.repeat(self._sample, SAMPLES - 1, axis=0)
        values = array("f", SAMPLES * values_of(FILLER))
        self._ready = serialize_message(Float32MultiArray(data=values))
        self._port, self._floor = port, floor
        self._writer = ChunkWriter(port, MessageType.FLOAT32_MULTI_ARRAY, CHANNELS)

    def publish(self, chunks: int) -> dict[str, list[float]]:
        """Publish so many of each in turn; return their times in microseconds.

        That of the node is from the last sample of a chunk to the end of its publishing,
        that of the floor is rclpy's alone.
        """
        self._port.count_readers()
        times: dict[str, list[float]] = {"node": [], "floor": []}
        for _ in range(chunks):
            self._begin()
            times["node"].append(_timed_us(lambda: self._writer.add(self._sample, SAMPLES)))
            self._begin()
            times["floor"].append(_timed_us(lambda: self._floor.publish(self._ready)))
            self._writer.discard()
        return times

    def _begin(self) -> None:
        """Collect what comes before the last sample; to wake from a sleep is not counted."""
        time.sleep(_PAUSE_S)
        self._writer.add(self._all_but_one, SAMPLES)


def _timed_us(call: Callable[[], None]) -> float:
    begin_ns = time.perf_counter_ns()
    call()
    return (time.perf_counter_ns() - begin_ns) / 1e3


def publish(topic: str, floor_topic: str) -> None:
    """Publish one of each until the parent orders COUNT; say the times of so many as JSON."""
    orders, ports = (
        Orders(),
        TopicPublishers(rclpy.create_node("bench_publisher"), Pacer(Pace(), print)),
    )
    publisher = Publisher(*(ports.open(each, Float32MultiArray) for each in (topic, floor_topic)))
    order = None
    while order is None and not orders.closed.is_set():
        publisher.publish(1)
        order = orders.poll()
    if order is not None:
        say(json.dumps(publisher.publish(int(order))))


if __name__ == "__main__":
    rclpy.init()
    publish(sys.argv[1], sys.argv[2])
    rclpy.shutdown()
