"""Publishes ``/diagnostics`` and ``~/streams``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import monotonic

import pylsl
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy

from lsl_to_ros.accounts.load import Load, LoadFacts
from lsl_to_ros.accounts.ros_time import RosTime
from lsl_to_ros.lsl.discovery import Discovery
from lsl_to_ros.lsl.hosts import Senders
from lsl_to_ros.reports.devices import device_statuses
from lsl_to_ros.reports.diagnostics import status, stream_facts, stream_status
from lsl_to_ros.reports.overload import overload
from lsl_to_ros.reports.stream_list import TOPIC, stream_list
from lsl_to_ros.routing import Route, Routing
from lsl_to_ros.topics.outputs import HAS_STAMPED_TOPICS
from lsl_to_ros.topics.publishers import make_publisher

_NO_STAMPS = "biosensor_msgs is not installed: there are no _stamped topics; build it with colcon"
_MISSING = "" if HAS_STAMPED_TOPICS else _NO_STAMPS


class Reporting:
    """Publishes both topics."""

    def __init__(
        self,
        node: Node,
        routing: Routing,
        discovery: Discovery,
        senders: Senders,
        ros_time: RosTime,
        warn: Callable[[str], None],
    ) -> None:
        self._node = node
        self._clock = node.get_clock()
        self._routing = routing
        self._discovery = discovery
        self._senders = senders
        self._ros_time = ros_time
        self._warn = warn
        self._load = Load()
        self._overloads = False, False
        self._diagnostics = make_publisher(node, "/diagnostics", DiagnosticArray)
        self._streams = make_publisher(node, TOPIC, DiagnosticArray, latched=True)
        self.list_streams()
        if _MISSING:
            warn(_MISSING)

    def list_streams(self) -> None:
        """Publish which stream fills which topics."""
        self._streams.publish(stream_list(self._routing.routes, self._clock.now().to_msg()))

    def look(self) -> None:
        """See how long samples have waited in liblsl and for their turn; call it often."""
        now_s = monotonic()
        for route in self._routing.routes:
            bridge, inlet = route.bridge, route.inlet
            if bridge is not None and inlet.is_delivering:
                # In this order: what is read in between then counts as gone, not as late.
                received = bridge.tally.received
                age_s = route.health.backlog.age(now_s, received, inlet.waiting)
                age_s += bridge.oldest_waiting_s
                route.health.waited(age_s)
                self._load.waited(age_s)

    def report(self) -> None:
        """Publish the state of everything."""
        step = self._ros_time.refresh()
        if step is not None:
            self._warn(f"the system clock jumped by {step.size_ns / 1e9:.6f} s; stamps follow")
        array = DiagnosticArray()
        array.header.stamp = self._clock.now().to_msg()
        routes = self._routing.routes
        statuses = [self._node_status(len(routes), self._look_at_load())]
        statuses += [entry for route in routes if (entry := self._stream_status(route)) is not None]
        bridges = [
            (self._routing.device_name(route), route.bridge)
            for route in routes
            if route.bridge is not None
        ]
        array.status = [*statuses, *device_statuses(bridges)]
        self._diagnostics.publish(array)

    def _stream_status(self, route: Route) -> DiagnosticStatus | None:
        if route.bridge is None or route.topic is None:
            return None
        inlet = route.inlet
        facts = stream_facts(
            route.topic,
            route.bridge,
            route.health,
            inlet.correction,
            inlet.correction_spread,
            pylsl.local_clock(),
            self._senders.trouble(inlet.core.hostname),
        )
        if facts.is_fast:
            topic = route.bridge.outputs.of_samples[0].publisher.name
            facts = replace(facts, best_effort=self._best_effort_readers(topic))
        return stream_status(facts)

    def _best_effort_readers(self, topic: str) -> list[str]:
        """Ask DDS; of its readers' queues, it does not tell the length."""
        infos = self._node.get_subscriptions_info_by_topic(topic)
        return sorted(
            {
                info.node_name
                for info in infos
                if info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
            }
        )

    def _look_at_load(self) -> LoadFacts:
        was_busy, was_late = self._overloads
        load = self._load.look()
        if (load.is_busy and not was_busy) or (load.is_late and not was_late):
            self._warn(overload(load))
        self._overloads = load.is_busy, load.is_late
        return load

    def _node_status(self, streams: int, load: LoadFacts) -> DiagnosticStatus:
        values = {
            "cpu_percent": "" if load.share is None else f"{100 * load.share:.0f}",
            "queue_age_s": f"{load.age_s:.3f}",
            "streams": str(streams),
            "streams_refused": str(self._discovery.refused),
            "clock_steps": str(self._ros_time.steps),
            "stamped_topics": "yes" if HAS_STAMPED_TOPICS else "no",
            "liblsl": str(pylsl.library_version()),
        }
        reasons = [reason for reason in (overload(load), _MISSING) if reason]
        level = DiagnosticStatus.WARN if reasons else DiagnosticStatus.OK
        return status("node", level, "; ".join(reasons) or f"{streams} streams", values)
