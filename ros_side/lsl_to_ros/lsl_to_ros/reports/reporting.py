"""Publishes ``/diagnostics`` and ``~/streams``."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import Header

from lsl_to_ros.accounts.ros_time import RosTime
from lsl_to_ros.reports.merging import merged
from lsl_to_ros.reports.processes import ProcessFacts, node_status, process_status
from lsl_to_ros.topics.outputs import HAS_STAMPED_TOPICS
from lsl_to_ros.topics.publishers import make_publisher

TOPIC = "~/streams"
_NO_STAMPS = "biosensor_msgs is not installed: there are no _stamped topics; build it with colcon"
_MISSING = "" if HAS_STAMPED_TOPICS else _NO_STAMPS


class Reporting:
    """Publishes both topics, for all processes of the node."""

    def __init__(self, node: Node, ros_time: RosTime, warn: Callable[[str], None]) -> None:
        self._clock = node.get_clock()
        self._ros_time = ros_time
        self._diagnostics = make_publisher(node, "/diagnostics", DiagnosticArray)
        self._streams = make_publisher(node, TOPIC, DiagnosticArray, latched=True)
        self._listed: list[DiagnosticStatus] | None = None
        self.list_streams([])
        if _MISSING:
            warn(_MISSING)

    def list_streams(self, entries: Sequence[DiagnosticStatus]) -> None:
        """Publish which stream fills which topics, if that has changed."""
        ordered = sorted(entries, key=lambda entry: entry.name)
        if ordered == self._listed:
            return
        self._listed = ordered
        self._streams.publish(DiagnosticArray(header=self._header(), status=ordered))

    def report(self, processes: Sequence[ProcessFacts]) -> None:
        """Publish the state of everything; the first process is this one."""
        values = {
            "clock_steps": str(self._ros_time.steps),
            "stamped_topics": "yes" if HAS_STAMPED_TOPICS else "no",
        }
        statuses = [node_status(processes, values, _MISSING)]
        if len(processes) > 1:
            statuses += [process_status(each) for each in processes]
        statuses += [entry for each in processes for entry in each.statuses]
        statuses += merged(entry for each in processes for entry in each.devices)
        self._diagnostics.publish(DiagnosticArray(header=self._header(), status=statuses))

    def _header(self) -> Header:
        return Header(stamp=self._clock.now().to_msg())
