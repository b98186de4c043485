"""Queries the ROS graph, and subscribes to a topic that is sent as its publishers need."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from time import monotonic
from typing import NamedTuple

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from biosensor_common.errors import GatewayError
from biosensor_common.refusal import Refusal
from biosensor_common.ros.fields import all_fields
from lsl_to_ros.ros_to_lsl.class_fields import bulk_of, fields_of, message_class
from lsl_to_ros.ros_to_lsl.topic_bridge import OLD_MESSAGES_S, Bridge, MessageType
from lsl_to_ros.statistics.status import StreamStatus
from lsl_to_ros.subscriber_thread import MessageInfo, RosMessage, TakenElsewhere, Taker, nobody

QUEUE = 1000
"""Queue depth: one second of the fastest topics that Python can receive."""
_STREAM_LIST = "/streams"
_STREAM_LIST_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
# rmw's node name for a participant that was discovered but has not announced its nodes.
_UNNAMED = "_NODE_NAME_UNKNOWN_"
_OF_ROS = frozenset({"/rosout", "/parameter_events", "/clock"})


class Quality(NamedTuple):
    """Quality of service of a subscription, as offered by the publishers."""

    # Whether all are reliable; a reliable subscriber does not match others.
    is_reliable: bool = True
    is_latched: bool = False  # Whether all keep their last messages for late subscribers.

    @property
    def profile(self) -> QoSProfile:
        """Return the QoS profile."""
        return QoSProfile(
            depth=QUEUE,
            reliability=ReliabilityPolicy.RELIABLE
            if self.is_reliable
            else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL
            if self.is_latched
            else DurabilityPolicy.VOLATILE,
        )

    def __str__(self) -> str:
        reliability = "reliable" if self.is_reliable else "best effort"
        return f"{reliability}, {'transient local' if self.is_latched else 'volatile'}"


def quality_of(publishers: Sequence[TopicEndpointInfo]) -> Quality:
    """Return a quality of service that matches all these publishers."""
    profiles = [each.qos_profile for each in publishers]
    return Quality(
        all(each.reliability is not ReliabilityPolicy.BEST_EFFORT for each in profiles),
        bool(profiles)
        and all(each.durability is DurabilityPolicy.TRANSIENT_LOCAL for each in profiles),
    )


def are_named(publishers: Iterable[TopicEndpointInfo]) -> bool:
    """Whether the nodes of all publishers are known, which takes a little longer."""
    return all(each.node_name != _UNNAMED for each in publishers)


class Graph:
    """A snapshot of the topics in the ROS graph.

    Nodes of ``lsl_to_ros`` are recognised by the topic ``~/streams`` that each of them publishes,
    whatever their names.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        # Types of the topics, by full name.
        self.topics: Mapping[str, list[str]] = dict(node.get_topic_names_and_types())
        self._own = full_name(node.get_namespace(), node.get_name())
        self._gateways = set(self._find_gateways())

    def publishers(self, topic: str) -> list[TopicEndpointInfo]:
        """Return the publishers of a topic."""
        return list(self._node.get_publishers_info_by_topic(topic)) if topic in self.topics else []

    def is_ours(self, publishers: Iterable[TopicEndpointInfo]) -> bool:
        """Whether one of them is a node of ``lsl_to_ros``, or this node itself."""
        return any(self._is_gateway(each) for each in publishers)

    def small(self) -> list[str]:
        """Return the topics that ``all_small`` means.

        Excluded are hidden topics, ROS's own, and those with unbounded byte sequences: images and
        point clouds.
        """
        return [topic for topic in self._shown() if all(map(_is_small, self.topics[topic]))]

    def left_out(self) -> list[str]:
        """Return the topics that ``all_small`` leaves out because of their type."""
        return [topic for topic in self._shown() if not all(map(_is_small, self.topics[topic]))]

    def _shown(self) -> list[str]:
        return [topic for topic in self.topics if topic not in _OF_ROS and "/_" not in topic]

    def _find_gateways(self) -> Iterable[str]:
        for topic, types in self.topics.items():
            if topic.endswith(_STREAM_LIST) and _STREAM_LIST_TYPE in types:
                for each in self._node.get_publishers_info_by_topic(topic):
                    name = full_name(each.node_namespace, each.node_name)
                    if topic == name + _STREAM_LIST:
                        yield name

    def _is_gateway(self, publisher: TopicEndpointInfo) -> bool:
        name = full_name(publisher.node_namespace, publisher.node_name)
        return name == self._own or name in self._gateways


def full_name(namespace: str, name: str) -> str:
    """Return a node's name with its namespace."""
    return f"{namespace.rstrip('/')}/{name}"


def _is_small(type_name: str) -> bool:
    try:
        kind = message_class(type_name)
    except GatewayError:
        return False
    return not (bulk_of(kind) or any(each.is_blob for each in all_fields(fields_of(kind))))


_USUAL = Quality()
"""Quality of service for a topic without publishers: what most of them will offer."""


class Topic:
    """Subscribes to a topic with its publishers' quality of service, again when that changes.

    Attributes
    ----------
    status
        State for its reports.
    sender
        Full name of the publishing node; empty if there is none, or several.
    """

    def __init__(
        self,
        node: Node,
        taker: Taker,
        group: TakenElsewhere,
        bridge: Bridge,
        say: Callable[[str], None],
    ) -> None:
        self._node, self._taker, self._group, self._say = node, taker, group, say
        self.bridge, self.status = bridge, StreamStatus()
        self.kind: MessageType | None = None  # Type of the messages; None before it is known.
        self.quality = Quality()
        self.publishers, self.sender = 0, ""
        self._subscription: Subscription | None = None
        self._subscribed_s = 0.0
        if bridge.request.type_name:
            # Subscribed before anybody publishes, because the first message may be the only one.
            self._connect(bridge.request.type_name, "")

    @property
    def name(self) -> str:
        """Full name of the topic."""
        return self.bridge.request.topic

    @property
    def is_subscribed(self) -> bool:
        """Whether it is subscribed to now."""
        return self._subscription is not None

    @property
    def wants_offset(self) -> bool:
        """Whether its publisher's clock should be measured."""
        return any(each.wants_offset for each in self.bridge.stampings)

    def follow(self, publishers: Sequence[TopicEndpointInfo]) -> int:
        """Update the publishers; return the number of newly lost messages."""
        self.publishers = len(publishers)
        senders = {full_name(each.node_namespace, each.node_name) for each in publishers}
        is_one = len(senders) == 1 and are_named(publishers)
        self.sender = senders.pop() if is_one else ""
        if publishers and self.kind is None:
            first = publishers[0]
            self._connect(first.topic_type, str(first.topic_type_hash), quality_of(publishers))
        elif publishers and self.kind is not None:
            self._tell_others(publishers, self.kind.name)
            of_kind = [p for p in publishers if p.topic_type == self.kind.name]
            self.bridge.stamping.is_mixed = len(of_kind) > 1
            is_mixed = len(of_kind) > 1 and self.bridge.sends_numbers
            self.bridge.refusals.hold(Refusal.MIXED, is_mixed, publishers=len(of_kind))
            quality = quality_of(of_kind)
            if self._subscription is not None and quality != self.quality:
                self._say(f"its publishers are {quality} now, and so is the subscription")
                self._subscribe(quality)
        return self.bridge.losses.look(len(publishers))

    def refuse(self, reason: str) -> None:
        """Send nothing while there is a reason."""
        self._unsubscribe()
        self.kind = None
        self.bridge.refuse(reason)

    def _connect(self, type_name: str, type_hash: str, quality: Quality = _USUAL) -> None:
        try:
            self.kind = MessageType(type_name, type_hash, message_class(type_name))
        except GatewayError as error:
            self.bridge.refuse(str(error))
            return
        self.bridge.refuse("")
        self.bridge.connect(self.kind)
        if not self.bridge.fault:
            self._subscribe(quality)

    def _tell_others(self, publishers: Sequence[TopicEndpointInfo], type_name: str) -> None:
        others = sorted({each.topic_type for each in publishers} - {type_name})
        hold = self.bridge.refusals.hold
        hold(Refusal.OTHER_TYPE, bool(others), types=", ".join(others), sent=type_name)

    def _subscribe(self, quality: Quality) -> None:
        assert self.kind is not None
        self._unsubscribe()
        self.quality, self._subscribed_s = quality, monotonic()
        self.bridge.is_latched = quality.is_latched
        self._subscription = self._node.create_subscription(
            self.kind.message_class,
            self.name,
            nobody,
            quality.profile,
            callback_group=self._group,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        self._taker.add(self._subscription, self._take)

    def _unsubscribe(self) -> None:
        if self._subscription is not None:
            self._taker.remove(self._subscription)
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _take(self, message: RosMessage, info: MessageInfo) -> None:
        is_new = monotonic() - self._subscribed_s < OLD_MESSAGES_S
        self.bridge.take(message, info, may_be_old=self.quality.is_latched and is_new)
