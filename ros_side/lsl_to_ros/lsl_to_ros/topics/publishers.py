"""The node's publishers, and how many subscribers each has."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, NamedTuple

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo

from biosensor_common.quantities import piece_messages, queue_depth
from lsl_to_ros.parameters.node import QOS_OVERRIDES
from lsl_to_ros.topics.lanes import Lane, Pacer

_POLICIES = (
    QoSPolicyKind.HISTORY,
    QoSPolicyKind.DEPTH,
    QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY,
)

# Pairs of an offered and an incompatible requested policy.
_TOO_LITTLE = (
    (ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE),
    (DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL),
)


class TopicTypeError(Exception):
    """A topic cannot be opened: it has another message type, or ROS refuses it."""


class TopicPublisher:
    """One topic, with its number of subscribers.

    Subscribers are counted when :meth:`count_readers` is called, because asking for
    each sample would cost as much as building its message.
    """

    def __init__(
        self,
        topic: str,
        kind: type[Any],
        ros_publisher: Publisher,
        pacer: Pacer,
        rate: float = 0.0,
        *,
        latched: bool,
    ) -> None:
        # topic, name: relative and full name.
        self.topic = topic
        self.name = ros_publisher.topic_name
        # As ROS writes it, such as `std_msgs/msg/Float32`.
        self.type_name = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
        # Whether late subscribers get the last message, so that each message is published.
        self.latched = latched
        self.readers = 0  # Number of subscribers at the last count.
        self.ros_publisher = ros_publisher
        piece = piece_messages(rate)
        self.lane = Lane(
            _publish_to(ros_publisher),
            self._is_taken,
            pacer,
            rate=rate,
            piece=piece,
            topic=self.name,
        )

    def publish(self, *messages: object) -> None:
        """Publish messages, or their bytes, in order; most messages of a burst are delayed."""
        self.lane.send(messages)

    @property
    def is_wanted(self) -> bool:
        """Whether to publish at all."""
        return self.readers > 0 or self.latched

    def count_readers(self) -> None:
        """Ask ROS for the number of matched subscribers."""
        self.readers = self.ros_publisher.get_subscription_count()

    def misfit(self, reader: TopicEndpointInfo) -> str:
        """Return why a subscriber gets nothing; empty if it is compatible."""
        who = f"{reader.node_namespace.rstrip('/')}/{reader.node_name}"
        if reader.topic_type != self.type_name:
            return f"{who} subscribes to it as {reader.topic_type}, but it is {self.type_name}"
        # rclpy can compare more policies, but DDS reports other values for "none" than those set.
        offered, asked = self.ros_publisher.qos_profile, reader.qos_profile
        pairs = ((offered.reliability, asked.reliability), (offered.durability, asked.durability))
        missing = [
            f"{there.name.lower()} and not {wanted.name.lower()}"
            for there, wanted in pairs
            if (there, wanted) in _TOO_LITTLE
        ]
        return f"it is {' and '.join(missing)}, as {who} requests" if missing else ""

    def _is_taken(self) -> bool:
        """Whether the reliable subscribers have received all published messages."""
        if self.latched or not self.readers:
            return True
        return self.ros_publisher.wait_for_all_acked(Duration(seconds=0.0))


def _publish_to(ros_publisher: Publisher) -> Callable[[Any], None]:
    """Return a function that publishes a message, or serialised bytes."""
    # rclpy's own method takes a sixth longer: it checks the type first, and locks the publisher,
    # which is never destroyed while a lane has it.
    publish_bytes: Callable[[bytes], None] = ros_publisher.handle.publish_raw

    def publish(message: object) -> None:
        if type(message) is bytes:
            publish_bytes(message)
        else:
            ros_publisher.publish(message)

    return publish


class _Key(NamedTuple):
    topic: str
    kind: type[Any]


class TopicPublishers:
    """All publishers of the node; topics of absent streams stay open.

    Its subscribers then need not match again when the stream returns.
    """

    def __init__(self, node: Node, pacer: Pacer) -> None:
        self._node = node
        self._pacer = pacer
        self._open: dict[_Key, TopicPublisher] = {}

    def open(
        self,
        topic: str,
        kind: type[Any],
        rate: float = 0.0,
        *,
        latched: bool = False,
        used: Collection[TopicPublisher] = (),
    ) -> TopicPublisher:
        """Return the publisher of a topic; one of another type that is not used is closed.

        Parameters
        ----------
        rate
            Rate of the messages in Hz.
        used
            Publishers of the present streams.

        Raises
        ------
        TopicTypeError
            If the topic is used with another type, or ROS refuses it.
        """
        key = _Key(topic, kind)
        publisher = self._open.pop(key, None)
        if publisher is None:
            if any(other.topic == topic for other in used):
                raise TopicTypeError(f"{topic} is in use with a type other than {kind.__name__}")
            self.close(lambda other: other.topic == topic)
            try:
                ros_publisher = make_publisher(self._node, topic, kind, rate, latched=latched)
            except Exception as error:  # rclpy has no common class for what it refuses
                reason = str(error).splitlines()[0]
                raise TopicTypeError(f"ROS refuses the topic {topic[:200]} ({reason})") from error
            publisher = TopicPublisher(
                topic, kind, ros_publisher, self._pacer, rate, latched=latched
            )
        # Moved to the end, so that the order is that of the last use.
        self._open[key] = publisher
        return publisher

    def count_readers(self) -> None:
        """Count the subscribers of every topic."""
        for publisher in self._open.values():
            publisher.count_readers()

    def close(self, is_to_close: Callable[[TopicPublisher], bool]) -> list[str]:
        """Close the topics for which *is_to_close* returns true; return their names."""
        keys = [key for key, publisher in self._open.items() if is_to_close(publisher)]
        for key in keys:
            publisher = self._open.pop(key)
            publisher.lane.flush()
            self._node.destroy_publisher(publisher.ros_publisher)
        return [key.topic for key in keys]

    def close_oldest(self, used: Collection[TopicPublisher], spare: int) -> None:
        """Close unused topics, the oldest first, until *spare* of them are left."""
        unused = [publisher for publisher in self._open.values() if publisher not in used]
        closing = set(unused[: max(0, len(unused) - spare)])
        self.close(lambda publisher: publisher in closing)


def make_publisher(
    node: Node, topic: str, kind: type[Any], rate: float = 0.0, *, latched: bool = False
) -> Publisher:
    """Make a reliable publisher whose quality of service parameters can override.

    The queue holds the messages of half a minute. Latched means transient local with a
    depth of 1. The overrides are ROS's own, named
    ``qos_overrides.<topic>.publisher.<policy>`` and read when the topic opens.
    """
    qos = QoSProfile(depth=queue_depth(rate))
    if latched:
        qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    return node.create_publisher(
        kind,
        topic,
        qos,
        # The executor would check the event handlers in every turn: 7 % of a core for 300 topics.
        event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
        qos_overriding_options=QoSOverridingOptions(_overridden(node, topic)),
    )


def _overridden(node: Node, topic: str) -> list[QoSPolicyKind]:
    """Return the policies that a user has set: ROS declares a parameter for each of them."""
    try:
        owner = f"{QOS_OVERRIDES}{node.resolve_topic_name(topic)}.publisher"
    except RuntimeError:
        # nothing is dropped: whoever makes the publisher says what is wrong with the name
        return []
    return [each for each in _POLICIES if node.has_parameter(f"{owner}.{each.name.lower()}")]
