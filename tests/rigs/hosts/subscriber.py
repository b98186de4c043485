"""Subscribes reliably to every topic of the biosensors and keeps what comes.

    python -m tests.rigs.hosts.subscriber [--best-effort TOPIC]

Steered: ``state`` tells which topics have matched, how many messages came and the
newest diagnostics; ``save`` writes the messages to ``path`` and the diagnostics beside
it. Messages are read when they are saved, so that receiving them costs little.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from tests.rigs.hosts import completeness
from tests.rigs.hosts.completeness import Recording, canonical
from tests.rigs.hosts.programs import Dialogue

# Neither is in the part of rclpy that this project's stubs describe. The usual executor
# would take most of a core for as many topics.
_executors: Any = import_module("rclpy.experimental")
_event_handlers: Any = import_module("rclpy.event_handler")

DEPTH = 20_000
LOOK_S = 0.25
# Behind the participant, where there is one.
_PREFIX = "/biosensors/"
_PACKAGES = ("std_msgs", "diagnostic_msgs", "sensor_msgs")
BEST_EFFORT = " (best effort)"
_NS_PER_S = 1_000_000_000


class Topic:
    """One subscription and what came over it, unread."""

    def __init__(self, message_type: type[Any]) -> None:
        self.type = message_type
        self.matched = False
        self.arrivals: list[float] = []
        self.messages: list[bytes] = []

    def take(self, message: bytes) -> None:
        self.arrivals.append(time.time())
        self.messages.append(message)

    def take_match(self, status: Any) -> None:
        self.matched = status.current_count > 0

    def recording(self) -> Recording:
        """Read the messages; a chunk's samples all came with it."""
        messages = [deserialize_message(each, self.type) for each in self.messages]
        rows = [_rows(message) for message in messages]
        lengths = [len(each) for each in rows]
        stamps = np.array([_stamp_ns(message) for message in messages], np.int64)
        return Recording(
            np.repeat(np.array(self.arrivals, np.float64), lengths),
            np.repeat(stamps, lengths),
            np.concatenate(rows) if rows else np.empty((0, 1), np.float32),
        )


def _rows(message: Any) -> NDArray[Any]:
    """Samples of a message, shape (samples, channels)."""
    if isinstance(message, DiagnosticArray):
        return np.array([[_counters(message)]])
    value = getattr(message, "data", getattr(message, "temperature", ""))
    if isinstance(value, str):
        return np.array([[value]])
    dimensions = message.layout.dim if hasattr(message, "layout") else ()
    samples = dimensions[0].size if len(dimensions) > 1 else 1
    return np.array(value, np.float32).reshape(samples, -1)


def _counters(message: DiagnosticArray) -> str:
    return canonical(
        {
            status.name: {item.key: float(item.value) for item in status.values}
            for status in message.status
        }
    )


def _stamp_ns(message: Any) -> int:
    if not hasattr(message, "header"):
        return 0
    return message.header.stamp.sec * _NS_PER_S + message.header.stamp.nanosec


class Subscriber:
    """All subscriptions; *best_effort* is subscribed to a second time, with that reliability."""

    def __init__(self, node: Any, best_effort: str) -> None:
        self._node = node
        self._best_effort = best_effort
        self._topics: dict[str, Topic] = {}
        self._diagnostics: list[tuple[float, dict[str, dict[str, str]]]] = []
        node.create_subscription(DiagnosticArray, "/diagnostics", self._take_diagnostics, 100)
        node.create_timer(LOOK_S, self._look)

    def obey(self, command: Mapping[str, Any]) -> Any:
        match command["do"]:
            case "state":
                return {
                    "matched": [name for name, topic in self._topics.items() if topic.matched],
                    "received": {n: len(topic.messages) for n, topic in self._topics.items()},
                    "diagnostics": self._diagnostics[-1][1] if self._diagnostics else {},
                    "diagnosed_s": self._diagnostics[-1][0] if self._diagnostics else 0.0,
                }
            case "save":
                path = Path(command["path"])
                completeness.save(path, {n: t.recording() for n, t in self._topics.items()})
                path.with_suffix(".json").write_text(json.dumps(self._diagnostics))
                return None
            case other:
                raise ValueError(f"what is {other!r}?")

    def _look(self) -> None:
        for name, kinds in self._node.get_topic_names_and_types():
            package, _, kind = kinds[0].split("/")
            if name in self._topics or _PREFIX not in name or package not in _PACKAGES:
                continue
            message_type = getattr(import_module(f"{package}.msg"), kind)
            self._subscribe(name, name, message_type, ReliabilityPolicy.RELIABLE)
            if name == self._best_effort:
                label = name + BEST_EFFORT
                self._subscribe(label, name, message_type, ReliabilityPolicy.BEST_EFFORT)

    def _subscribe(
        self, label: str, name: str, message_type: type[Any], reliability: ReliabilityPolicy
    ) -> None:
        self._topics[label] = topic = Topic(message_type)
        self._node.create_subscription(
            message_type,
            name,
            topic.take,
            QoSProfile(depth=DEPTH, reliability=reliability),
            event_callbacks=_event_handlers.SubscriptionEventCallbacks(matched=topic.take_match),
            raw=True,
        )

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        facts = {
            status.name: {"level": status.level.hex(), "message": status.message}
            | {item.key: item.value for item in status.values}
            for status in message.status
        }
        by_topic = {entry["topic"]: entry for entry in facts.values() if "topic" in entry}
        self._diagnostics.append((time.time(), by_topic))


def main() -> None:
    parser = argparse.ArgumentParser(description="Keeps what is published of the biosensors.")
    parser.add_argument("--best-effort", default="", help="topic to receive so, too")
    options = parser.parse_args()
    rclpy.init(args=None)
    node: Any = rclpy.create_node("subscriber")
    subscriber = Subscriber(node, options.best_effort)
    executor = _executors.EventsExecutor()
    executor.add_node(node)
    dialogue = Dialogue()
    while not dialogue.ended:
        executor.spin_once(timeout_sec=0.1)
        dialogue.answer(subscriber.obey)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
