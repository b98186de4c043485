"""One topic that is sent, whose subscription adapts to its publishers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import monotonic

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from biosensor_common.errors import GatewayError
from biosensor_common.refusal import Refusal
from lsl_to_ros.ros_to_lsl.bridge import OLD_MESSAGES_S, Bridge, MessageType
from lsl_to_ros.ros_to_lsl.fields import message_class
from lsl_to_ros.ros_to_lsl.graph import Quality, are_named, full_name, quality_of
from lsl_to_ros.statistics.stream_status import StreamStatus
from lsl_to_ros.subscriber_thread import MessageInfo, RosMessage, TakenElsewhere, Taker, nobody

_USUAL = Quality()
"""Quality of service for a topic without publishers: what most of them will offer."""


class Topic:
    """Subscribes to a topic with its publishers' quality of service, again when that changes.

    Attributes
    ----------
    status
        State for its reports.
    kind
        Type of the messages; None before it is known.
    quality
        Quality of service of the subscription.
    publishers
        Number of publishers.
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
        self.kind: MessageType | None = None
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
            quality = quality_of([p for p in publishers if p.topic_type == self.kind.name])
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
