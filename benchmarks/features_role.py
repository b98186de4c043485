"""How late beats are in ROS: a subscriber that also asks LSL when each beat was.

``python -m benchmarks.features_role``; says ``streaming`` once beats come on every topic,
measures from an order to the next one, and answers with `Lateness` of each topic as JSON.
"""

from __future__ import annotations

import json
import threading
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pylsl
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Float32MultiArray

from benchmarks.child import Orders, say
from biosensor_common.quantities import ContentType

BEATS = "beats"
_FIND_S, _POLL_S = 5.0, 0.002
_MOST = 1000
_FULL_S = 10.0


@dataclass(frozen=True, slots=True)
class Lateness:
    """What one topic's beats, and the samples that they were found in, took to arrive."""

    topic: str
    from_type: str  # LSL type of the stream that the beats were found in.
    beats_s: Sequence[float]  # From each beat to its message in the callback of a subscriber.
    # From each sample of the raw stream to its arrival by LSL: most of it the packet in which the
    # device keeps it back.
    samples_s: Sequence[float]


class _Topic:
    """One stream of beats, its topic, and the raw stream behind it."""

    def __init__(self, node: Node, info: pylsl.StreamInfo) -> None:
        self._beats = pylsl.StreamInlet(info)
        header = ET.fromstring(self._beats.info(_FULL_S).as_xml())
        source_id = header.findtext("desc/features/source_id") or ""
        (raw,) = pylsl.resolve_byprop("source_id", source_id, 1, _FULL_S)
        self._raw = pylsl.StreamInlet(raw)
        self._type = raw.type()
        sensor = header.findtext("desc/biosensor/sensor")
        self.topic = f"/biosensors/{sensor}/{BEATS}"
        self._stamps: dict[float, float] = {}
        self._arrivals: list[tuple[float, float]] = []
        self._ages: list[float] = []
        node.create_subscription(Float32MultiArray, self.topic, self._heard, 100)

    def _heard(self, message: Float32MultiArray) -> None:
        # An interval has a dozen digits: it tells which beat this is.
        self._arrivals.append((message.data[0], pylsl.local_clock()))

    @property
    def is_measured(self) -> bool:
        """Whether anything of the raw stream has come."""
        return bool(self._ages)

    @property
    def has_come(self) -> bool:
        """Whether beats have come by both ways."""
        return bool(self._arrivals and self._stamps)

    def poll(self) -> None:
        """Take what LSL has."""
        values, stamps = self._beats.pull_chunk()
        for value, stamp in zip(values, stamps, strict=True):
            self._stamps[float(np.float32(value[0]))] = stamp
        _, stamps = self._raw.pull_chunk(max_samples=4096)
        now_s = pylsl.local_clock()
        self._ages += [now_s - stamp for stamp in stamps]

    def begin(self) -> None:
        """Forget what came."""
        self._stamps.clear()
        self._arrivals.clear()
        self._ages.clear()

    def end(self) -> Lateness:
        """Return what came since."""
        known = [(at_s, self._stamps.get(value)) for value, at_s in list(self._arrivals)]
        late = [at_s - stamp for at_s, stamp in known if stamp is not None]
        return Lateness(self.topic, self._type, late, self._ages)


def _found() -> dict[str, pylsl.StreamInfo]:
    # Of that type alone: the rest of two hundred would be in the way.
    found = pylsl.resolve_byprop("type", ContentType.RR.value, _MOST, _FIND_S)
    return {each.source_id(): each for each in found if each.source_id().endswith(f"-{BEATS}")}


def _topics(node: Node) -> list[_Topic]:
    """Return the streams of beats, once no new one appears."""
    before, found = dict[str, pylsl.StreamInfo](), _found()
    while not found or found.keys() != before.keys():
        before, found = found, _found()
    return [_Topic(node, each) for each in found.values()]


def _spin(executor: SingleThreadedExecutor, ending: threading.Event) -> None:
    while not ending.is_set():
        executor.spin_once(timeout_sec=0.1)


def _poll_until(topics: Sequence[_Topic], holds: Callable[[], bool]) -> None:
    while not holds():
        for each in topics:
            each.poll()
        time.sleep(_POLL_S)


def _poll_until_told(topics: Sequence[_Topic], orders: Orders) -> None:
    _poll_until(topics, lambda: orders.poll() is not None)


def main() -> None:
    """Measure as the parent orders."""
    orders = Orders()
    rclpy.init()
    node = rclpy.create_node("features_role")
    topics = _topics(node)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    ending = threading.Event()
    spinning = threading.Thread(target=_spin, args=(executor, ending))
    spinning.start()
    look_s = time.monotonic() + _FULL_S
    _poll_until(topics, lambda: time.monotonic() > look_s)
    # A headband has a stream of light that is off unless it is asked for.
    topics = [each for each in topics if each.is_measured]
    _poll_until(topics, lambda: all(each.has_come for each in topics))
    say("streaming")
    _poll_until_told(topics, orders)
    for each in topics:
        each.begin()
    say("measuring")
    _poll_until_told(topics, orders)
    say(json.dumps([asdict(each.end()) for each in topics]))
    ending.set()
    spinning.join()
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
