"""Which stream fills which topics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from math import ceil

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile

from biosensor_common import naming
from biosensor_common.naming import TopicName, resolve_topics
from biosensor_common.quantities import MessageType
from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import StreamHeader
from lsl_to_ros import messages
from lsl_to_ros.bridge import Bridge, Tally
from lsl_to_ros.diagnostics import RateMeter
from lsl_to_ros.inlets import Inlet
from lsl_to_ros.losses import LossAccount
from lsl_to_ros.parameters import Parameters
from lsl_to_ros.ros_time import RosTime

# A late subscriber of these sees the last value at once.
LATCHED = frozenset({"bat", "rssi", "dev"})
MIN_DEPTH, MAX_DEPTH = 10, 10_000


@dataclass(slots=True)
class Route:
    """One attached stream on its way to ROS."""

    inlet: Inlet
    header: StreamHeader
    topic: TopicName | None = None
    bridge: Bridge | None = None
    meter: RateMeter = field(default_factory=RateMeter)


@dataclass(slots=True)
class _Record:
    """What is counted of a stream over all its outlets."""

    uid: str = ""
    account: LossAccount = field(default_factory=LossAccount)
    tally: Tally = field(default_factory=Tally)


class Routing:
    """Connects inlets to topics, anew whenever the set of streams changes.

    Parameters
    ----------
    node
        Owner of the publishers.
    prefix
        First part of every topic, relative.
    """

    def __init__(self, node: Node, prefix: str, parameters: Parameters, ros_time: RosTime) -> None:
        self._node = node
        self._prefix = prefix
        self._parameters = parameters
        self._time = ros_time
        self._routes: dict[str, Route] = {}
        self._topics: dict[tuple[str, MessageType], Publisher] = {}
        self._records: dict[tuple[str, str], _Record] = {}
        self._accounts: dict[str, LossAccount] = {}
        self._seen: set[DeviceIdentity] = set()

    @property
    def routes(self) -> list[Route]:
        """All attached streams."""
        return list(self._routes.values())

    def update(self, ready: list[Inlet], gone: list[Inlet]) -> None:
        """Attach and detach streams."""
        for inlet in gone:
            if self._routes.pop(inlet.uid, None) is not None:
                self._node.get_logger().info(f"stream {inlet.source_id or inlet.uid} is gone")
        for inlet in ready:
            if inlet.header is not None:
                self._routes[inlet.uid] = Route(inlet, inlet.header)
        if ready or gone:
            self._map_topics()

    def apply_settings(self) -> None:
        """Let every stream follow the parameters from its next sample on."""
        for route in self.routes:
            if route.bridge is not None:
                header = route.header
                route.bridge.settings = self._parameters.settings(
                    header.identity, header.data_name, header.chunk
                )

    def _map_topics(self) -> None:
        """Give every stream its topic; a stream whose topic changes gets a new bridge."""
        names = {
            uid: (route.header.identity, route.header.data_name)
            for uid, route in self._routes.items()
        }
        renamed: list[TopicName] = []
        # A unit that has left keeps its name: another one's data must not appear under it.
        self._seen.update(
            route.header.identity for route in self.routes if _is_named_after_unit(route.header)
        )
        for uid, topic in resolve_topics(names, self._prefix, gone=self._seen).items():
            route = self._routes[uid]
            if route.bridge is not None and route.topic == topic:
                continue
            if route.topic is not None:
                renamed.append(route.topic)
            self._connect(route, topic)
        self._close({topic.base for topic in renamed} | self._crowded())

    def _crowded(self) -> set[str]:
        """Names that several units would have; the one that had it may be absent by now."""
        return {
            naming.topic(route.header.identity, route.header.data_name, self._prefix).rpartition(
                "/"
            )[0]
            for route in self._routes.values()
            if route.topic is not None and route.topic.conflict
        }

    def _connect(self, route: Route, topic: TopicName) -> None:
        header = route.header
        record = self._record(route.inlet, header)
        self._parameters.declare(header.identity, header.data_name, header.chunk)
        route.topic = topic
        route.bridge = Bridge(
            header,
            raw=self._publisher(topic.name, header.message_type, header),
            chunk=self._chunk_publisher(_chunk_topic(topic, header), header),
            settings=self._parameters.settings(header.identity, header.data_name, header.chunk),
            account=record.account,
            tally=record.tally,
            to_time=partial(self._to_time, route.inlet),
            warn=self._warn,
            listen=self._listener(header),
            latched=_is_latched(header),
        )
        if topic.conflict:
            self._warn(f"{topic.name}: two units share a name; give each a label in its settings")
        route.inlet.deliver_to(route.bridge)
        self._node.get_logger().info(f"{topic.name} ({header.message_type})")

    def _chunk_publisher(self, name: str, header: StreamHeader) -> Publisher | None:
        if not name:
            return None
        return self._publisher(name, messages.chunk_type(header.message_type), header)

    def _publisher(self, name: str, kind: MessageType, header: StreamHeader) -> Publisher:
        key = (name, kind)
        if key not in self._topics:
            # The rate of another program's stream may be any number.
            depth = ceil(min(max(header.rate, MIN_DEPTH), MAX_DEPTH))
            qos = QoSProfile(depth=depth)
            if _is_latched(header):
                qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._topics[key] = self._node.create_publisher(messages.CLASSES[kind], name, qos)
        return self._topics[key]

    def _close(self, bases: set[str]) -> None:
        """Close what nobody publishes any more under these names.

        Topics of streams that are merely absent stay: their subscribers then need
        not match anew when the stream returns.
        """
        used = {route.topic.base for route in self._routes.values() if route.topic is not None}
        for name, kind in list(self._topics):
            if name.rpartition("/")[0] in bases - used:
                self._node.destroy_publisher(self._topics.pop((name, kind)))

    def _record(self, inlet: Inlet, header: StreamHeader) -> _Record:
        key = (inlet.source_id or inlet.uid, header.data_name)
        record = self._records.setdefault(key, _Record())
        if record.uid != inlet.uid:
            record.uid = inlet.uid
            record.account.restarted()
        if not header.foreign:
            self._accounts[inlet.source_id] = record.account
        return record

    def _listener(self, header: StreamHeader) -> Callable[[str], None] | None:
        is_counters = header.message_type is MessageType.DIAGNOSTIC_ARRAY
        return self._take_counters if is_counters else None

    def _take_counters(self, text: str) -> None:
        """Hand on the agent's counters; runs in that stream's thread."""
        try:
            counters = messages.read_counters(text)
        except ValueError:
            return
        for source_id, entry in counters.items():
            known = self._accounts.get(source_id)
            if known is not None:
                known.reported(int(entry["pushed"]), int(entry["lost"]), entry["last_stamp"])

    def _to_time(self, inlet: Inlet, stamp: float) -> Time:
        return self._time.to_msg(stamp + (inlet.correction or 0.0))

    def _warn(self, sentence: str) -> None:
        self._node.get_logger().warning(sentence)


def _chunk_topic(topic: TopicName, header: StreamHeader) -> str:
    if not header.chunk:
        return ""
    data = topic.data if header.chunk == header.data_name else header.chunk
    return f"{topic.base}/{data}_chunk"


def _is_latched(header: StreamHeader) -> bool:
    return header.data_name in LATCHED and not header.foreign


def _is_named_after_unit(header: StreamHeader) -> bool:
    """Whether the name stands for one device for good.

    A participant or a label names a place, where a device may be replaced, and
    another program may give its stream a new source_id at every start.
    """
    identity = header.identity
    return not (header.foreign or identity.participant or identity.label)
