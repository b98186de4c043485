"""Publishes ``/diagnostics`` and ``~/streams``."""

from __future__ import annotations

from collections.abc import Callable

import pylsl
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from lsl_to_ros.accounts.ros_time import RosTime
from lsl_to_ros.lsl.discovery import Discovery
from lsl_to_ros.lsl.hosts import Senders
from lsl_to_ros.reports.devices import device_statuses
from lsl_to_ros.reports.diagnostics import status, stream_facts, stream_status
from lsl_to_ros.reports.stream_list import TOPIC, stream_list
from lsl_to_ros.routing import Route, Routing
from lsl_to_ros.topics.outputs import HAS_STAMPED_TOPICS
from lsl_to_ros.topics.publishers import make_publisher

_NO_STAMPS = "biosensor_msgs is not installed: there are no _stamped topics; build it with colcon"


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
        self._clock = node.get_clock()
        self._routing = routing
        self._discovery = discovery
        self._senders = senders
        self._ros_time = ros_time
        self._warn = warn
        self._diagnostics = make_publisher(node, "/diagnostics", DiagnosticArray)
        self._streams = make_publisher(node, TOPIC, DiagnosticArray, latched=True)
        self.list_streams()
        if not HAS_STAMPED_TOPICS:
            warn(_NO_STAMPS)

    def list_streams(self) -> None:
        """Publish which stream fills which topics."""
        self._streams.publish(stream_list(self._routing.routes, self._clock.now().to_msg()))

    def report(self) -> None:
        """Publish the state of everything."""
        step = self._ros_time.refresh()
        if step is not None:
            self._warn(f"the system clock jumped by {step.size_ns / 1e9:.6f} s; stamps follow")
        array = DiagnosticArray()
        array.header.stamp = self._clock.now().to_msg()
        routes = self._routing.routes
        statuses = [self._node_status(len(routes))]
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
        return stream_status(facts)

    def _node_status(self, streams: int) -> DiagnosticStatus:
        values = {
            "streams": str(streams),
            "streams_refused": str(self._discovery.refused),
            "clock_steps": str(self._ros_time.steps),
            "stamped_topics": "yes" if HAS_STAMPED_TOPICS else "no",
            "liblsl": str(pylsl.library_version()),
        }
        if HAS_STAMPED_TOPICS:
            return status("node", DiagnosticStatus.OK, f"{streams} streams", values)
        return status("node", DiagnosticStatus.WARN, _NO_STAMPS, values)
