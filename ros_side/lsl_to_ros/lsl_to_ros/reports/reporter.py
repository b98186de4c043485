"""Collects the state of streams and devices, and publishes it on ``/diagnostics`` and others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from time import monotonic
from typing import NamedTuple

import pylsl
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import Header

from biosensor_common.quantities import ROLES_OF_DEVICE, TYPES_OF_DEVICE, ChannelRole
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.stream_header import StreamHeader
from lsl_to_ros.lsl.discovery import Discovery
from lsl_to_ros.lsl.inlets import Senders
from lsl_to_ros.parameters.node import COMPAT, DIAGNOSTICS_PERIOD, SMARTLAB
from lsl_to_ros.reports.diagnostics import (
    LEASE_S,
    away_sentence,
    crowded_out,
    named_by,
    overload,
    status,
    stream_facts,
    stream_status,
)
from lsl_to_ros.routes import Route, Routing
from lsl_to_ros.statistics.ros_time import RosTime
from lsl_to_ros.statistics.status import Load, LoadFacts
from lsl_to_ros.topics.bridge import Bridge
from lsl_to_ros.topics.originals import ORIGINALS
from lsl_to_ros.topics.outputs import HAS_STAMPED_TOPICS
from lsl_to_ros.topics.publishers import make_publisher

LOW_BATTERY_PERCENT = 10.0


class Concern(NamedTuple):
    """A problem, with its level in ``/diagnostics``."""

    level: int
    text: str


@dataclass(frozen=True, slots=True)
class Part:
    """Content of a report."""

    load: LoadFacts
    # streams, refused: number of streams, and of those that cannot be used.
    streams: int
    refused: int
    crowded_out: Sequence[str]  # Names of streams beyond the limit of open files.
    concerns: Sequence[Concern]  # Data that was left out or guessed and has no separate entry.
    # statuses, devices: statuses of the streams, and of their devices as reported in these streams.
    statuses: Sequence[DiagnosticStatus]
    devices: Sequence[DiagnosticStatus]


class Survey:
    """Collects the state of the whole node."""

    def __init__(
        self,
        node: Node,
        routing: Routing,
        discovery: Discovery,
        senders: Senders,
        warn: Callable[[str], None],
    ) -> None:
        self._node = node
        self._routing = routing
        self._discovery = discovery
        self._senders = senders
        self._warn = warn
        self._load = Load()
        self._doubled: dict[str, float] = {}
        self._has_said_doubled = False
        self._overloads = False, False

    def look(self) -> None:
        """Measure how long samples wait in liblsl and for publishing; call it often."""
        now_s = monotonic()
        for route in self._routing.routes:
            bridge, inlet = route.bridge, route.inlet
            if bridge is not None and inlet.is_delivering:
                # In this order, samples that are read in between count as delivered, not as late.
                received = bridge.counters.received
                age_s = route.status.backlog.age(now_s, received, inlet.waiting)
                age_s += bridge.oldest_waiting_s
                route.status.waited(age_s)
                self._load.waited(age_s)

    def part(self) -> Part:
        """Return the state of everything; call it once a second."""
        routes = self._routing.routes
        load = self._look_at_load()
        streams = [
            StreamOfDevice(self._routing.device_name(route), route.bridge, entry)
            for route in routes
            if route.bridge is not None and (entry := self._stream_status(route)) is not None
        ]
        statuses = [each.status for each in streams]
        devices = list(device_statuses(streams))
        discovery = self._discovery
        crowded_out = sorted(discovery.crowded_out)
        return Part(
            load,
            len(routes),
            discovery.refused,
            crowded_out,
            concerns_of(discovery.refusals, self._routing.refusals),
            statuses,
            devices,
        )

    def _stream_status(self, route: Route) -> DiagnosticStatus | None:
        if route.bridge is None or route.topic is None:
            return None
        inlet = route.inlet
        self._look_at_readers(route.bridge)
        facts = stream_facts(
            route.topic,
            route.bridge,
            route.status,
            inlet.correction,
            inlet.correction_spread,
            pylsl.local_clock(),
            self._senders.trouble(inlet.core.hostname),
        )
        topic = route.bridge.outputs.of_samples[0].publisher.name
        facts = replace(
            facts,
            twins=self._discovery.twins(inlet),
            senders=self._discovery.senders(inlet),
            doubled_s=self._doubled_for_s(topic),
        )
        if facts.is_fast:
            facts = replace(facts, best_effort=self._best_effort_readers(topic))
        return stream_status(facts)

    def _look_at_readers(self, bridge: Bridge) -> None:
        """Report subscribers of a stream's topics that are incompatible and receive nothing."""
        key = bridge.header.identity.sensor, bridge.header.data_name
        is_known_otherwise = key in ORIGINALS and bridge.outputs.shape is None
        for publisher in bridge.outputs.publishers:
            name = publisher.name
            # Matched subscribers are counted often anyway, and counting all costs little.
            has_others = self._node.count_subscribers(name) > publisher.readers
            known = self._node.get_subscriptions_info_by_topic(name) if has_others else []
            told = [why for each in known if (why := publisher.misfit(each))]
            is_other_type = any(each.topic_type != publisher.type_name for each in known)
            if is_other_type and is_known_otherwise:
                told.append(f"with {COMPAT}:={SMARTLAB}, it is as in the original framework")
            why = "; ".join(dict.fromkeys(told))
            bridge.counters.refusals.hold(Refusal.READ_IN_VAIN, bool(why), about=name, why=why)

    def _doubled_for_s(self, topic: str) -> float:
        """Return for how many seconds another node has published a topic, too."""
        if self._node.count_publishers(topic) < 2:
            self._doubled.pop(topic, None)
            self._has_said_doubled &= bool(self._doubled)
            return 0.0
        for_s = monotonic() - self._doubled.setdefault(topic, monotonic())
        if for_s > LEASE_S and not self._has_said_doubled:
            self._warn(f"{topic}: {Refusal.DOUBLED.message()}; does this node run twice?")
        self._has_said_doubled |= for_s > LEASE_S
        return max(1e-9, for_s)

    def _best_effort_readers(self, topic: str) -> list[str]:
        """Return the nodes that read a topic with best effort, according to DDS."""
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


def concerns_of(*books: Refusals) -> list[Concern]:
    """Return refusals that are present now and have no separate entry."""
    shown = [each for book in books for each in book.present]
    # Streams beyond the limit of files are counted and named together.
    others = [each for each in shown if each.what is not Refusal.NO_FILES]
    return [Concern(each.what.level, each.sentence_about) for each in others]


class StreamOfDevice(NamedTuple):
    """A stream, its device's name in the topics, and its status."""

    device: str
    bridge: Bridge
    status: DiagnosticStatus


def device_statuses(streams: Iterable[StreamOfDevice]) -> Iterator[DiagnosticStatus]:
    """Make the status of each device: battery, contact, signal, and the agent's facts of its clock.

    Yields
    ------
    DiagnosticStatus
        WARN if it is paused or not connected, a battery is at 10 % or less, a sensor reports that
        it is not worn, or its agent leaves out some of what it sends; otherwise OK, but never
        better than its streams: ERROR or WARN if one of them is, and STALE if all regular ones are.
    """
    devices: defaultdict[str, list[StreamOfDevice]] = defaultdict(list)
    for each in streams:
        if not each.bridge.header.foreign:
            devices[each.device].append(each)
    for name, own in devices.items():
        told = [each.bridge for each in own if _is_about_device(each.bridge)]
        if not told:
            continue
        away = next((each.counters.said.away for each in told if each.counters.said.away), "")
        # What it sent last is of the past while it is away.
        of_now = [] if away else told
        reasons = [away_sentence(away)] if away else list(_concerns_of_device(of_now))
        levels = [DiagnosticStatus.WARN] * bool(reasons)
        # While it is away, its streams are stale or repeat that.
        shown = [each for each in own if not away or each.status.level == DiagnosticStatus.ERROR]
        levels += [_level_of_streams(shown)]
        reasons += _reasons_of_streams(shown)
        message = "; ".join(reasons) or "as its streams report"
        level = max(levels, key=_SEVERITY.index)
        texts = dict(_texts(of_now))
        yield status(f"device {name}", level, message, texts, told[0].header.identity.unit)


_SEVERITY = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.STALE,
    DiagnosticStatus.ERROR,
)


def _is_about_device(bridge: Bridge) -> bool:
    counters = bridge.counters
    return bool(_told(bridge.header) or counters.clock or counters.said.of_device)


def _level_of_streams(streams: Sequence[StreamOfDevice]) -> bytes:
    levels = {each.status.level for each in streams}
    regular = {each.status.level for each in streams if each.bridge.header.rate > 0}
    if DiagnosticStatus.ERROR in levels:
        return DiagnosticStatus.ERROR
    if (regular or levels) == {DiagnosticStatus.STALE}:
        return DiagnosticStatus.STALE
    return DiagnosticStatus.WARN if levels - {DiagnosticStatus.OK} else DiagnosticStatus.OK


def _reasons_of_streams(streams: Sequence[StreamOfDevice]) -> list[str]:
    """Return the sentences of streams that are not OK, the worst first, equal ones together."""
    bad = [each for each in streams if each.status.level != DiagnosticStatus.OK]
    together: defaultdict[str, list[str]] = defaultdict(list)
    for each in sorted(bad, key=lambda one: -_SEVERITY.index(one.status.level)):
        together[each.status.message].append(each.bridge.header.data_name)
    reasons = [f"{', '.join(names)}: {why}" for why, names in together.items()]
    more = len(reasons) - _MOST_NAMED
    return [*reasons[:_MOST_NAMED], *([f"and {more} more"] if more > 0 else [])]


def _texts(bridges: Iterable[Bridge]) -> Iterator[tuple[str, str]]:
    """Yield the newest values under their data and channel names, and the clock's state."""
    for bridge in bridges:
        for key, value in bridge.counters.clock.items():
            # Enough digits for an offset of years, to the microsecond.
            yield f"clock/{key}", f"{value:.6f}".rstrip("0").rstrip(".")
        data_name = bridge.header.data_name
        for column, value in _newest(bridge):
            yield f"{data_name}/{bridge.header.labels[column]}", f"{value:g}"


def _told(header: StreamHeader) -> list[int]:
    """Return the columns about the device: all columns for some content types."""
    if header.content_type in TYPES_OF_DEVICE:
        return list(range(len(header.roles)))
    return [column for column, role in enumerate(header.roles) if role in ROLES_OF_DEVICE]


def _newest(bridge: Bridge) -> Iterator[tuple[int, float]]:
    """Yield the newest values of a stream about its device, with their columns."""
    if bridge.newest is not None and not bridge.header.message_type.is_text:
        for column in _told(bridge.header):
            yield column, float(bridge.newest[column])


def _concerns_of_device(bridges: Sequence[Bridge]) -> Iterator[str]:
    """Yield what streams report about their device, and what its agent leaves out."""
    worn_or_charged = (
        why
        for bridge in bridges
        for column, value in _newest(bridge)
        if (why := _concern(bridge.header.roles[column], value))
    )
    yield from list(worn_or_charged)[:1]
    for bridge in bridges:
        yield from bridge.counters.said.of_device


def _concern(role: ChannelRole | None, value: float) -> str:
    # NaN, unknown, is neither.
    if role is ChannelRole.STATE_OF_CHARGE and value <= LOW_BATTERY_PERCENT:
        return f"battery at {value:g} %"
    return "not worn" if role is ChannelRole.CONTACT and value == 0 else ""


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
        named_by(self._node, statuses)
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
