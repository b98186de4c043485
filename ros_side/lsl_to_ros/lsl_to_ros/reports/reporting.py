"""Publishes ``/diagnostics`` and ``~/streams``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from time import monotonic

import pylsl
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from std_msgs.msg import Header

from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from lsl_to_ros.parameters.node import COMPAT, DIAGNOSTICS_PERIOD
from lsl_to_ros.reports.diagnostics import LEASE_S, crowded_out, overload, status
from lsl_to_ros.reports.survey import Concern, Part
from lsl_to_ros.routing import Route
from lsl_to_ros.statistics.ros_time import RosTime
from lsl_to_ros.topics.outputs import HAS_STAMPED_TOPICS
from lsl_to_ros.topics.publishers import make_publisher

TOPIC = "~/streams"
USE_SIM_TIME = "use_sim_time"
COMPUTER_BUSY = "computer_busy"
"""Key: whether other programs delay data in the node, ``true`` or ``false``."""
_MOST_NAMED = 5


class Rhythm:
    """Decides which of the reports, made once a second, are published.

    Parameters
    ----------
    period_s
        Returns the seconds between two published reports.
    """

    def __init__(self, period_s: Callable[[], float]) -> None:
        self._period_s = period_s
        self._levels: dict[str, bytes] = {}
        self._looks = 0

    def is_due(self, statuses: Iterable[DiagnosticStatus]) -> bool:
        """Whether to publish now; a changed level is published at once."""
        before, self._levels = self._levels, {each.name: each.level for each in statuses}
        self._looks += 1
        if self._levels == before and self._looks < round(self._period_s()):
            return False
        self._looks = 0
        return True


class Reporting:
    """Publishes both topics."""

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
        """Publish which stream is on which topics, if that has changed."""
        ordered = sorted(entries, key=lambda entry: entry.name)
        if ordered == self._listed:
            return
        self._listed = ordered
        self._streams.publish(DiagnosticArray(header=self._header(), status=ordered))

    def report(self, part: Part) -> None:
        """Publish the state of everything if a report is scheduled."""
        values = {
            "clock_steps": str(self._ros_time.steps),
            "stamped_topics": "yes" if HAS_STAMPED_TOPICS else "no",
            COMPAT: self._node.get_parameter(COMPAT).value,
        }
        statuses = [node_status(part, values, self._concerns()), *part.statuses, *part.devices]
        if self._rhythm.is_due(statuses):
            self._diagnostics.publish(DiagnosticArray(header=self._header(), status=statuses))

    def _concerns(self) -> list[Concern]:
        """Collect the concerns of the node as a whole."""
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


def node_status(
    part: Part, values: Mapping[str, str], concerns: Sequence[Concern]
) -> DiagnosticStatus:
    """Make the status of the node.

    Parameters
    ----------
    values, concerns
        Facts about the node as a whole, and its problems.
    """
    load = part.load
    facts = {
        "cpu_percent": "" if load.share is None else f"{100 * load.share:.0f}",
        "queue_age_s": f"{load.age_s:.3f}",
        COMPUTER_BUSY: str(load.is_late).lower(),
        "streams": str(part.streams),
        "streams_refused": str(part.refused),
        "streams_left_out": str(len(part.crowded_out)),
        **values,
        "liblsl": str(pylsl.library_version()),
    }
    level, reasons = _judge(part)
    level = max([level, *(bytes([each.level]) for each in concerns)])
    reasons = [*reasons, *(each.text for each in concerns)]
    return status("node", level, "; ".join(reasons) or f"{part.streams} streams", facts)


def _judge(part: Part) -> tuple[bytes, list[str]]:
    told = (overload(part.load), crowded_out(part.crowded_out))
    reasons = [each for each in told if each]
    level = max([int(bool(reasons)), *(each.level for each in part.concerns)])
    named = [each.text for each in part.concerns[:_MOST_NAMED]]
    more = [f"and {len(part.concerns) - len(named)} more"] * (len(part.concerns) > len(named))
    return bytes([level]), [*reasons, *named, *more]


def stream_list(routes: Iterable[Route]) -> list[DiagnosticStatus]:
    """Return one status per stream, named by its raw topic, with its facts as values."""
    return [_entry(route) for route in routes if route.bridge is not None]


def _entry(route: Route) -> DiagnosticStatus:
    assert route.bridge is not None
    header, core = route.header, route.inlet.core
    publishers = route.bridge.outputs.publishers
    values = {
        "lsl_name": core.name,
        "lsl_type": core.content_type,
        "source_id": core.source_id,
        "uid": route.inlet.uid,
        "host": core.hostname,
        "rate": f"{header.rate:g}",
        "format": header.format.value,
        "labels": ", ".join(header.labels),
        "units": ", ".join(header.units),
        "participant": header.identity.participant,
        "label": header.identity.label,
        "foreign": str(header.foreign).lower(),
        **{f"topic {publisher.name}": publisher.type_name for publisher in publishers},
    }
    return DiagnosticStatus(
        level=DiagnosticStatus.OK,
        name=publishers[0].name,
        message=f"{core.name} of {core.hostname}",
        hardware_id=header.identity.unit,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
