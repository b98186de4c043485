"""Publishes ``/diagnostics`` and ``~/streams``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from time import monotonic

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import Header

from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from lsl_to_ros.accounts.ros_time import RosTime
from lsl_to_ros.parameters.node import COMPAT, DIAGNOSTICS_PERIOD
from lsl_to_ros.reports.diagnostics import LEASE_S
from lsl_to_ros.reports.processes import Concern, ProcessFacts, node_status, process_status
from lsl_to_ros.topics.messages import HAS_STAMPED_TOPICS
from lsl_to_ros.topics.publishers import make_publisher

TOPIC = "~/streams"
USE_SIM_TIME = "use_sim_time"


class Rhythm:
    """Says which of the looks, one a second, are to be published.

    Parameters
    ----------
    period_s
        Returns the seconds between two reports.
    """

    def __init__(self, period_s: Callable[[], float]) -> None:
        self._period_s = period_s
        self._levels: dict[str, bytes] = {}
        self._looks = 0

    def is_due(self, statuses: Iterable[DiagnosticStatus]) -> bool:
        """Whether it is time; what has become worse or better does not wait."""
        before, self._levels = self._levels, {each.name: each.level for each in statuses}
        self._looks += 1
        if self._levels == before and self._looks < round(self._period_s()):
            return False
        self._looks = 0
        return True


class Reporting:
    """Publishes both topics, for all processes of the node."""

    def __init__(self, node: Node, ros_time: RosTime, warn: Callable[[str], None]) -> None:
        self._clock = node.get_clock()
        self._ros_time = ros_time
        self._diagnostics = make_publisher(node, "/diagnostics", DiagnosticArray)
        self._streams = make_publisher(node, TOPIC, DiagnosticArray, latched=True)
        self._listed: list[DiagnosticStatus] | None = None
        self.list_streams([])
        self._node = node
        self._refusals = Refusals(warn)
        self._doubled_s = monotonic()
        self._rhythm = Rhythm(lambda: node.get_parameter(DIAGNOSTICS_PERIOD).value)
        self._concerns()

    def list_streams(self, entries: Sequence[DiagnosticStatus]) -> None:
        """Publish which stream fills which topics, if that has changed."""
        ordered = sorted(entries, key=lambda entry: entry.name)
        if ordered == self._listed:
            return
        self._listed = ordered
        self._streams.publish(DiagnosticArray(header=self._header(), status=ordered))

    def report(self, processes: Sequence[ProcessFacts]) -> None:
        """Publish the state of everything if it is time; the first process is this one."""
        values = {
            "clock_steps": str(self._ros_time.steps),
            "stamped_topics": "yes" if HAS_STAMPED_TOPICS else "no",
            COMPAT: self._node.get_parameter(COMPAT).value,
        }
        statuses = [node_status(processes, values, self._concerns())]
        if len(processes) > 1:
            statuses += [process_status(each) for each in processes]
        statuses += [entry for each in processes for entry in each.statuses]
        statuses += merged(entry for each in processes for entry in each.devices)
        if self._rhythm.is_due(statuses):
            self._diagnostics.publish(DiagnosticArray(header=self._header(), status=statuses))

    def _concerns(self) -> list[Concern]:
        """Look at what concerns the whole node."""
        now_s = monotonic()
        if self._node.count_publishers(self._streams.topic_name) < 2:
            self._doubled_s = now_s
        twice_s = now_s - self._doubled_s
        is_simulated = self._node.get_parameter_or(USE_SIM_TIME).value is True
        found = {
            Refusal.NO_STAMPED_TOPICS: not HAS_STAMPED_TOPICS,
            Refusal.SIMULATED_TIME: is_simulated,
            Refusal.NODE_TWICE: twice_s > LEASE_S,
            Refusal.NODE_MAYBE_TWICE: 0 < twice_s <= LEASE_S,
        }
        for what, is_so in found.items():
            self._refusals.hold(what, is_so)
        return [Concern(each.what.level, each.sentence) for each in self._refusals.present]

    def _header(self) -> Header:
        return Header(stamp=self._clock.now().to_msg())


def merged(statuses: Iterable[DiagnosticStatus]) -> list[DiagnosticStatus]:
    """Return one entry for each name: the values of all, and the worst level with its reason.

    The streams of a device may be in several processes, and each of these tells of it what its
    own streams say.
    """
    by_name: dict[str, DiagnosticStatus] = {}
    for status in statuses:
        other = by_name.get(status.name)
        by_name[status.name] = status if other is None else _joined(other, status)
    return list(by_name.values())


def _joined(first: DiagnosticStatus, second: DiagnosticStatus) -> DiagnosticStatus:
    worse = second if second.level > first.level else first
    values = {value.key: value for value in (*first.values, *second.values)}
    return DiagnosticStatus(
        level=worse.level,
        name=first.name,
        message=worse.message,
        hardware_id=first.hardware_id or second.hardware_id,
        values=list(values.values()),
    )
