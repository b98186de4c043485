"""Publishes ``/diagnostics`` and ``~/streams``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import monotonic

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import Header

from lsl_to_ros.accounts.ros_time import RosTime
from lsl_to_ros.reports.diagnostics import LEASE_S
from lsl_to_ros.reports.merging import merged
from lsl_to_ros.reports.processes import Concern, ProcessFacts, node_status, process_status
from lsl_to_ros.topics.outputs import HAS_STAMPED_TOPICS
from lsl_to_ros.topics.publishers import make_publisher

TOPIC = "~/streams"
USE_SIM_TIME = "use_sim_time"
_NO_STAMPS = "biosensor_msgs is not installed: there are no _stamped topics; build it with colcon"
_TWICE = (
    "this node runs twice, under one name: each sample is published twice; end one of them, or give"
    " one another topic_prefix and name"
)
_MAY_BE_TWICE = (
    "another node of this name is known to DDS: it runs, too, or was killed less than half a minute"
    " ago"
)
_SIMULATED = (
    "use_sim_time is on: _stamped topics have the simulated time at which samples came, which is 0"
    " without /clock, and not when they were measured; leave it off for this node"
)


class Reporting:
    """Publishes both topics, for all processes of the node."""

    def __init__(self, node: Node, ros_time: RosTime, warn: Callable[[str], None]) -> None:
        self._clock = node.get_clock()
        self._ros_time = ros_time
        self._diagnostics = make_publisher(node, "/diagnostics", DiagnosticArray)
        self._streams = make_publisher(node, TOPIC, DiagnosticArray, latched=True)
        self._listed: list[DiagnosticStatus] | None = None
        self.list_streams([])
        self._node, self._warn = node, warn
        self._said: set[str] = set()
        self._doubled_s = monotonic()
        self._concerns()

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
        statuses = [node_status(processes, values, self._concerns())]
        if len(processes) > 1:
            statuses += [process_status(each) for each in processes]
        statuses += [entry for each in processes for entry in each.statuses]
        statuses += merged(entry for each in processes for entry in each.devices)
        self._diagnostics.publish(DiagnosticArray(header=self._header(), status=statuses))

    def _concerns(self) -> list[Concern]:
        """Look at what concerns the whole node; say what is new in the log."""
        now_s = monotonic()
        if self._node.count_publishers(self._streams.topic_name) < 2:
            self._doubled_s = now_s
        twice_s = now_s - self._doubled_s
        is_simulated = self._node.get_parameter_or(USE_SIM_TIME).value is True
        found = [
            Concern(DiagnosticStatus.WARN, _NO_STAMPS) if not HAS_STAMPED_TOPICS else None,
            Concern(DiagnosticStatus.WARN, _SIMULATED) if is_simulated else None,
            Concern(DiagnosticStatus.ERROR, _TWICE) if twice_s > LEASE_S else None,
            Concern(DiagnosticStatus.WARN, _MAY_BE_TWICE) if 0 < twice_s <= LEASE_S else None,
        ]
        concerns = [each for each in found if each is not None]
        for _, text in concerns:
            if text not in self._said and text != _MAY_BE_TWICE:
                self._warn(text)
        self._said = {text for _, text in concerns}
        return concerns

    def _header(self) -> Header:
        return Header(stamp=self._clock.now().to_msg())
