"""Queries the topics of the ROS graph and their publishers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from biosensor_common.errors import GatewayError
from biosensor_common.ros.fields import all_fields
from lsl_to_ros.ros_to_lsl.fields import bulk_of, fields_of, message_class

QUEUE = 1000
"""Queue depth: one second of the fastest topics that Python can receive."""
_STREAM_LIST = "/streams"
_STREAM_LIST_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
# rmw's node name for a participant that was discovered but has not announced its nodes.
_UNNAMED = "_NODE_NAME_UNKNOWN_"
_OF_ROS = frozenset({"/rosout", "/parameter_events", "/clock"})


class Quality(NamedTuple):
    """Quality of service of a subscription, as offered by the publishers.

    Attributes
    ----------
    is_reliable
        Whether all are reliable; a reliable subscriber does not match others.
    is_latched
        Whether all keep their last messages for late subscribers.
    """

    is_reliable: bool = True
    is_latched: bool = False

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

    Attributes
    ----------
    topics
        Types of the topics, by full name.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
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
