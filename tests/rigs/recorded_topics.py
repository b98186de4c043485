"""Topics that keep what is published on them, and headers of streams to publish."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, cast

import pytest
from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.time import Time as RclpyTime

from biosensor_common.spec import DeviceIdentity, FromDevice
from biosensor_common.stream_header import StreamHeader
from biosensor_gateway.devices.registry import declaration
from lsl_to_ros.statistics.ros_time import RosTime, Stamping
from lsl_to_ros.topics.lanes import Pace, Pacer
from lsl_to_ros.topics.publishers import TopicPublisher

DEVICE_RATE_HZ = 10.0
"""Of the declared streams whose rate only the device knows."""


def header_of(
    sensor_name: str, data_name: str, participant: str = "", label: str = "", **changes: Any
) -> StreamHeader:
    """Return what the node knows of a declared stream, altered as asked."""
    stream = declaration(sensor_name).stream(data_name)
    header = StreamHeader(
        identity=DeviceIdentity(sensor_name, "U1", participant, label),
        data_name=data_name,
        category=stream.category,
        content_type=stream.content_type.value,
        labels=stream.labels,
        units=tuple(str(channel.unit) for channel in stream.channels),
        roles=tuple(channel.role for channel in stream.channels),
        rate=DEVICE_RATE_HZ if isinstance(stream.rate, FromDevice) else stream.rate,
        format=stream.format,
        message_type=stream.message_type,
        chunk=stream.chunk,
        is_state=stream.is_state,
    )
    return replace(header, **changes)


@dataclass
class _Publisher:
    """What a port asks of a publisher; nothing leaves the process."""

    topic_name: str
    sent: list[Any] = field(default_factory=list[Any])
    readers: int = 0

    def publish(self, msg: Any) -> None:
        self.sent.append(msg)

    @property
    def handle(self) -> _Publisher:
        """What takes messages that are bytes already."""
        return self

    publish_raw = publish

    def get_subscription_count(self) -> int:
        return self.readers

    def wait_for_all_acked(self, timeout: Duration) -> bool:
        del timeout
        return True


class RecordedPublisher(TopicPublisher):
    """A topic whose messages stay here."""

    def __init__(
        self,
        kind: type[Any],
        topic: str = "biosensors/zephyr/ecg",
        *,
        readers: int = 1,
        latched: bool = False,
    ) -> None:
        self._publisher = _Publisher(f"/{topic}")
        self._kind = kind
        pacer = Pacer(Pace(), pytest.fail)
        super().__init__(topic, kind, cast("Publisher", self._publisher), pacer, latched=latched)
        self.set_readers(readers)

    def set_readers(self, readers: int) -> None:
        """Let so many subscribers be there, and be known."""
        self._publisher.readers = readers
        self.count_readers()

    @property
    def messages(self) -> list[Any]:
        """What subscribers get: all messages, over the wire."""
        return [
            deserialize_message(
                sent if isinstance(sent, bytes) else serialize_message(sent), self._kind
            )
            for sent in self._publisher.sent
        ]

    @property
    def values(self) -> list[Any]:
        """The data of the messages; arrays as lists."""
        return [
            list(message.data) if hasattr(message.data, "__len__") else message.data
            for message in self.messages
        ]


def message_time(unix_ns: int) -> Time:
    """Return a time as messages have it."""
    return RclpyTime(nanoseconds=unix_ns).to_msg()


class Clocks(Stamping):
    """A sender's clock that is measured when a test says so.

    Parameters
    ----------
    node
        Whose clock is the ROS time.
    correction
        Seconds between the sender's LSL clock and ours, None while unknown.
    """

    def __init__(self, node: Node, correction: float | None = 0.0) -> None:
        self.correction = correction
        self.ros_time = RosTime(node)
        super().__init__(self.ros_time, lambda: self.correction)
