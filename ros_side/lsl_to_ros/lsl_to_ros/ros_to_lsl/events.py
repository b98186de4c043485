"""The node's own stream of events, so that a recording says what happened to its topics.

Each is one JSON object in a string, as in ``gateway/events``. Every one has ``event`` and
``lsl_time``, and these have more:

=============  ===============================================================================
``started``    ``clock``: ``lsl_s`` and ``unix_ns``, this computer's clocks at one moment
``heartbeat``  every 5 s, and when somebody begins to receive: ``clock``; ``topics``: by name
               ``received``, ``lost`` (null: nobody knows), ``replaced``, ``stamped_by``,
               ``wrong_clocks``, ``clocks`` (of each its ``state`` and ``edge_s``), ``left_out``
               and ``fault``
``notice``     ``topic`` and ``text``: what the log says of a topic
=============  ===============================================================================
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable, Mapping

import pylsl
from rclpy.node import Node

from biosensor_common.clock_pair import measure_clock_pair
from biosensor_common.clocks import MonotonicStamps
from lsl_to_ros.reports.clock_pairs import events_outlet

HEARTBEAT_S = 5.0


class Events:
    """Sends events; any thread may.

    Parameters
    ----------
    node
        It says its name and domain, by which nodes of one computer differ.
    topics
        Tells of every topic, for the heartbeat.
    """

    def __init__(self, node: Node, topics: Callable[[], Mapping[str, object]]) -> None:
        self._topics = topics
        self._lock = threading.Lock()
        self._stamps = MonotonicStamps()
        self._due_s, self._had_consumers = -math.inf, False
        self._outlet = events_outlet(node, "ros_to_lsl")
        self._send("started", _clock())

    def notice(self, topic: str, text: str) -> None:
        """Say what the log says of a topic."""
        self._send("notice", {"topic": topic, "text": text})

    def look(self, now: float) -> None:
        """Send a heartbeat if one is due; a few times a second, with the LSL time."""
        has_consumers = self._outlet.have_consumers()
        has_come, self._had_consumers = has_consumers and not self._had_consumers, has_consumers
        if has_come or now >= self._due_s:
            self._due_s = now + HEARTBEAT_S
            self._send("heartbeat", {"topics": dict(self._topics()), **_clock()})

    def _send(self, event: str, facts: Mapping[str, object]) -> None:
        with self._lock:
            now = pylsl.local_clock()
            content = {"event": event, **facts, "lsl_time": round(now, 6)}
            (stamp,) = self._stamps.apply([now])
            self._outlet.push_sample([json.dumps(content, separators=(",", ":"))], stamp)


def _clock() -> dict[str, object]:
    return measure_clock_pair(time.time_ns, pylsl.local_clock).as_facts()
