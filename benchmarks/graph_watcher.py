"""Waits until the node has streams: ``python -m benchmarks.graph_watcher STREAMS``.

Says ``ready`` when it watches, ``graph`` and when every topic is in the ROS graph, and
``diagnostics`` and when one message of /diagnostics has them all. If that takes too
long, it ends and names what is missing.
"""

from __future__ import annotations

import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from benchmarks import ros_executor
from benchmarks.child import Orders, say
from benchmarks.samples import stream_names, topic_of

_POLL_S = 0.05
_PATIENCE_S = 60.0


class Watcher:
    """Looks for topics, first in the graph, then in /diagnostics."""

    def __init__(self, node: Node, topics: set[str]) -> None:
        self._node, self._topics = node, topics
        self._sources = ["graph", "diagnostics"]
        self._missing = topics
        self._end_s = time.monotonic() + _PATIENCE_S
        node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)
        node.create_timer(_POLL_S, self._poll)

    def _take(self, message: DiagnosticArray) -> None:
        names = {status.name.removeprefix("lsl_to_ros: ") for status in message.status}
        self._note("diagnostics", names)

    def _poll(self) -> None:
        self._note("graph", {name for name, _types in self._node.get_topic_names_and_types()})
        if self._sources and time.monotonic() > self._end_s:
            missing = ", ".join(sorted(self._missing))
            sys.exit(f"not in {self._sources[0]} after {_PATIENCE_S:.0f} s: {missing}")

    def _note(self, source: str, names: set[str]) -> None:
        if self._sources[:1] == [source]:
            self._missing = self._topics - names
            if not self._missing:
                self._sources.pop(0)
                say(f"{source} {time.monotonic()}")


def watch(streams: int) -> None:
    """Watch until the parent closes the pipe."""
    orders, node = Orders(), rclpy.create_node("bench_watcher")
    Watcher(node, {topic_of(name) for name in stream_names(streams)})
    say("ready")
    ros_executor.spin(ros_executor.usual_executor(node), orders)


if __name__ == "__main__":
    rclpy.init()
    watch(int(sys.argv[1]))
    rclpy.shutdown()
