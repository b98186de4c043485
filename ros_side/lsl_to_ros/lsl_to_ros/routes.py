"""Assigns topics to streams, and connects inlets to them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from numpy.typing import NDArray
from rclpy.node import Node

from biosensor_common import naming
from biosensor_common.lsl.inlet import Block
from biosensor_common.naming import TopicName, resolve_topics
from biosensor_common.quantities import ChannelFormat, MessageType
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.ros.messages import AgentSays, clock_of, read_counters, said_of_streams
from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import StreamHeader
from lsl_to_ros.limited_log import LimitedLog
from lsl_to_ros.lsl.inlets import Inlet
from lsl_to_ros.parameters.streams import Parameters, StreamSettings
from lsl_to_ros.statistics.losses import NodeCounters, can_estimate_losses
from lsl_to_ros.statistics.ros_time import RosTime, Stamping
from lsl_to_ros.statistics.status import StreamStatus
from lsl_to_ros.topics.bridge import Bridge, Outputs
from lsl_to_ros.topics.lanes import Pacer
from lsl_to_ros.topics.originals import BESIDE, ORIGINALS, Alone, Joined, Original, Shape
from lsl_to_ros.topics.outputs import open_outputs
from lsl_to_ros.topics.publishers import TopicPublisher, TopicPublishers, TopicTypeError
from lsl_to_ros.topics.writers import StreamContext

# Number of topics of absent streams that stay open for their subscribers.
ABSENT_TOPICS = 1000


@dataclass(slots=True)
class Route:
    """One attached stream with its topic and bridge."""

    inlet: Inlet
    header: StreamHeader
    topic: TopicName | None = None
    bridge: Bridge | None = None
    status: StreamStatus = field(default_factory=StreamStatus)


@dataclass(slots=True)
class _Record:
    """State of a stream that outlives its outlets."""

    counters: NodeCounters
    uid: str = ""
    shape: tuple[int, ChannelFormat, float] | None = None


class Routing:
    """Connects inlets to topics, again whenever the set of streams changes.

    Parameters
    ----------
    prefix
        First part of every topic, relative.
    aliases
        Sensor names by the names of other programs' LSL streams.
    is_as_original
        Whether topics have the original framework's form, see `topics.originals`.
    """

    def __init__(
        self,
        node: Node,
        prefix: str,
        parameters: Parameters,
        ros_time: RosTime,
        log: LimitedLog,
        pacer: Pacer,
        aliases: Mapping[str, str] = MappingProxyType({}),
        *,
        is_as_original: bool = False,
    ) -> None:
        self._aliases = aliases
        self._is_as_original = is_as_original
        self._joined: dict[tuple[DeviceIdentity, str], Joined] = {}
        self._publishers = TopicPublishers(node, pacer)
        self._prefix = prefix
        # Devices that keep their names, because another device's data must not appear under them.
        self._lasting: set[DeviceIdentity] = set()
        self._parameters = parameters
        self._time = ros_time
        self._log = log
        self._warn = log.warn
        # Reports of data not published unchanged that have no separate entry.
        self.refusals = pacer.refusals
        self._routes: dict[str, Route] = {}
        self._records: dict[tuple[str, str], _Record] = {}
        self._counters: dict[str, NodeCounters] = {}
        self._newest: list[Route] = []
        self._due: list[Route] = []

    def device_name(self, route: Route) -> str:
        """Return the name of a stream's device in its topics: ``p01/zephyr_left``."""
        return route.topic.frame_id(self._prefix) if route.topic else ""

    @property
    def routes(self) -> list[Route]:
        """All attached streams."""
        return list(self._routes.values())

    def update(self, ready: list[Inlet], gone: list[Inlet]) -> bool:
        """Attach and detach streams; return whether anything changed."""
        # A lost stream may be unknown here, because ended outlets are reported for a while.
        left = [route for inlet in gone if (route := self._routes.pop(inlet.uid, None))]
        for route in left:
            name = route.topic.name if route.topic else route.inlet.core.name
            self._log.inform(f"{name}: its stream is gone")
        for inlet in ready:
            if inlet.header is not None and inlet.is_served:
                header = renamed(inlet.header, inlet.core.name, self._aliases)
                self._routes[inlet.uid] = Route(inlet, header)
            elif inlet.header is not None:
                self._listen_only(inlet, inlet.header)
        has_changed = bool(ready or left)
        if has_changed:
            headers = (route.header for route in self._routes.values())
            self._lasting |= {each.identity for each in headers if _is_named_after_unit(each)}
            self._map_topics()
        return has_changed

    def set_prefix(self, prefix: str) -> None:
        """Move every topic; those of absent streams are closed."""
        if prefix != self._prefix:
            self._prefix = prefix
            self._map_topics()
            used = self._used_publishers()
            self._publishers.close(lambda publisher: publisher not in used)

    def apply_settings(self) -> None:
        """Let every stream follow the parameters from its next sample on."""
        for route in self.routes:
            if route.bridge is not None:
                header = route.header
                route.bridge.settings = self._parameters.settings(
                    header.identity, header.data_name, header.chunk
                )

    def count_readers(self) -> None:
        """Count the subscribers of every topic, and start delivery of new streams.

        A stream starts one look after its topics were opened. By then waiting subscribers
        have found them, and liblsl buffers the samples.
        """
        self._publishers.count_readers()
        due, self._due, self._newest = self._due, self._newest, []
        for route in due:
            is_here = self._routes.get(route.inlet.uid) is route
            if is_here and route.bridge is not None and not route.inlet.is_delivering:
                route.inlet.deliver_to(route.bridge)

    def _map_topics(self) -> None:
        """Give every stream its topic; a stream whose topic changes gets a new bridge."""
        headers = {uid: route.header for uid, route in self._routes.items()}
        wanted = {uid: (header.identity, header.data_name) for uid, header in headers.items()}
        topics = resolve_topics(wanted, self._prefix, gone=self._lasting)
        left: set[str] = set()
        for uid, route in self._routes.items():
            topic = topics[uid]
            old, route.topic = route.topic, topic
            if old is None or old.name != topic.name:
                left.update([old.base] if old else [])
                self._connect(route, topic)
        self._close_topics(left | self._crowded(topics))

    def _crowded(self, topics: Mapping[str, TopicName]) -> set[str]:
        """Return names that several units would have, including units that are absent now."""
        crowded = [self._routes[uid].header for uid, topic in topics.items() if topic.conflict]
        return {
            naming.topic(header.identity, header.data_name, self._prefix).rpartition("/")[0]
            for header in crowded
        }

    def _close_topics(self, bases: set[str]) -> None:
        """Close unused topics below these names, and topics whose type has changed.

        Topics of absent streams stay open, so that their subscribers need not match
        again when the stream returns.
        """
        used = self._used_publishers()
        names = {publisher.name for publisher in used}
        bases -= {publisher.topic.rpartition("/")[0] for publisher in used}
        changed = self._publishers.close(
            lambda publisher: publisher.name in names and publisher not in used
        )
        for topic in changed:
            # nothing is dropped: the topic goes on with the other type
            self._warn(f"{topic}: the stream came back in another format; the topic's type changes")
        self._publishers.close(lambda publisher: publisher.topic.rpartition("/")[0] in bases)
        self._publishers.close_oldest(used, ABSENT_TOPICS)

    def _used_publishers(self) -> set[TopicPublisher]:
        bridges = (route.bridge for route in self._routes.values())
        return {
            publisher for bridge in bridges if bridge for publisher in bridge.outputs.publishers
        }

    def _connect(self, route: Route, topic: TopicName) -> None:
        header, inlet = route.header, route.inlet
        counters = self._record(route).counters
        if counters.received:
            # Samples that are lost until the stream is back count as lost.
            lost = counters.lost(can_estimate=can_estimate_losses(header))
            route.status.recent(max(lost.count, 0), 0)
        self._parameters.declare(header.identity, header.data_name, header.chunk)
        stamping = Stamping(self._time, lambda: inlet.correction)
        context = StreamContext(
            header=header,
            topic=topic,
            frame_id=topic.frame_id(self._prefix),
            stamping=stamping,
            lost=lambda: counters.lost(can_estimate=can_estimate_losses(header)),
            refusals=counters.refusals,
        )
        used = self._used_publishers()
        originals = self._originals(header)
        shape = self._shape(header, originals, counters.refusals)
        try:
            outputs = open_outputs(self._publishers, context, used, originals, shape)
        except TopicTypeError as error:
            route.bridge = None
            refuse, name = self.refusals.refuse, inlet.core.name
            refuse(Refusal.NO_TOPIC, about=topic.name, why=error, name=name)
            return
        self.refusals.over(Refusal.NO_TOPIC, topic.name)
        route.bridge = Bridge(
            header,
            outputs,
            settings=self._parameters.settings(header.identity, header.data_name, header.chunk),
            counters=counters,
            stamping=stamping,
            listen=self._listener(header),
        )
        if isinstance(shape, Joined):
            shape.more = route.bridge.more
        if topic.conflict and header.identity.sensor != naming.AGENT:
            # nothing is dropped: each has a topic, and its entry says so
            self._warn(f"{topic.name}: {Refusal.TWO_UNITS.message()}")
        if inlet.is_delivering:
            inlet.deliver_to(route.bridge)
        else:
            self._newest.append(route)
        replay = f", a replay of {header.replay.title}" if header.replay else ""
        # nothing is dropped: it begins
        self._log.inform(f"{topic.name} ({header.message_type}){replay}")

    def _listen_only(self, inlet: Inlet, header: StreamHeader) -> None:
        """Receive an agent's counters that another node publishes."""
        bridge = Bridge(
            header,
            Outputs(),
            settings=StreamSettings(raw=False, chunk=False, chunk_length=1),
            counters=NodeCounters(),
            stamping=Stamping(self._time, lambda: inlet.correction),
            listen=self._listener(header),
        )
        inlet.deliver_to(bridge)

    def _record(self, route: Route) -> _Record:
        inlet, header = route.inlet, route.header
        key = (inlet.source_id or inlet.uid, header.data_name)
        if key not in self._records:
            about = f"{header.identity.sensor} {header.data_name}"
            self._records[key] = _Record(NodeCounters(refusals=Refusals(self._warn, about)))
        record = self._records[key]
        shape = (len(header.labels), header.format, header.rate)
        if record.uid != inlet.uid:
            if record.uid:
                record.counters.outlet_changed()
            if record.shape not in (None, shape):
                name = route.topic.name if route.topic else inlet.core.name
                record.counters.shape_changed(name, *shape)
            record.uid, record.shape = inlet.uid, shape
        if not header.foreign:
            self._counters[inlet.source_id] = record.counters
        return record

    def _originals(self, header: StreamHeader) -> Sequence[Original]:
        is_meant = self._is_as_original and not header.foreign
        return ORIGINALS.get(_key(header), ()) if is_meant else ()

    def _shape(
        self, header: StreamHeader, originals: Sequence[Original], refusals: Refusals
    ) -> Shape | None:
        if not originals:
            return None  # nothing is dropped: samples are published as they are
        if not originals[0].beside:
            return Alone(originals[0])
        joined = self._joined_of(header, header.data_name, originals[0])
        joined.refusals = refusals
        return joined

    def _joined_of(self, header: StreamHeader, data_name: str, original: Original) -> Joined:
        return self._joined.setdefault((header.identity, data_name), Joined(original))

    def _listener(self, header: StreamHeader) -> Callable[[Block], None] | None:
        part_of = BESIDE.get(_key(header), "")
        if part_of and self._is_as_original and not header.foreign:
            (original,) = ORIGINALS[header.identity.sensor, part_of]
            return self._joined_of(header, part_of, original).take
        is_counters = header.message_type is MessageType.DIAGNOSTIC_ARRAY
        # Counters in a replay are about samples of another computer and day.
        return self._take_counters if is_counters and header.replay is None else None

    def _take_counters(self, block: Block) -> None:
        """Apply the agent's counters; runs in the thread that reads their stream."""
        for sample in block.samples:
            self._take_report(sample)

    def _take_report(self, sample: NDArray[Any]) -> None:
        try:
            told, said = read_counters(sample[0]), said_of_streams(sample[0])
        except ValueError as error:
            self.refusals.refuse(Refusal.NO_COUNTS, about="gateway/counters", why=error)
            return
        for source_id, entry in told.items():
            known = self._counters.get(source_id)
            if known is not None:
                pushed, lost = int(entry["pushed"]), int(entry["lost"])
                known.comparison.reported(pushed, lost, entry["last_stamp"])
                known.clock = clock_of(entry)
                known.said = said.get(source_id, AgentSays())


def _key(header: StreamHeader) -> tuple[str, str]:
    return header.identity.sensor, header.data_name


def renamed(header: StreamHeader, lsl_name: str, aliases: Mapping[str, str]) -> StreamHeader:
    """Return the header of a stream with the user's sensor name for it, if there is one.

    Streams of agents keep their names, because label and participant are set in the agent.

    Parameters
    ----------
    aliases
        Sensor names by LSL stream names, in which ``*`` matches any text; the first match is used.
    """
    for pattern, alias in aliases.items():
        texts = map(re.escape, pattern.split("*"))
        if header.foreign and re.fullmatch(".*".join(texts), lsl_name, re.DOTALL):
            return replace(header, identity=replace(header.identity, sensor=alias))
    return header


def _is_named_after_unit(header: StreamHeader) -> bool:
    """Whether the name always denotes the same device.

    A participant or a label denotes a place, where a device may be replaced, and another
    program may give its stream a new source_id at every start.
    """
    identity = header.identity
    return not (header.foreign or identity.participant or identity.label)
