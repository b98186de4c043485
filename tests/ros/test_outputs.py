"""Which topics a stream opens, and values that stay for whoever subscribes later."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import BatteryState
from std_msgs.msg import (
    Float32,
    Float32MultiArray,
    Float64MultiArray,
    Int32MultiArray,
    Int64MultiArray,
    String,
)

from biosensor_common.naming import TopicName
from biosensor_common.quantities import ChannelFormat, ContentType, MessageType
from biosensor_common.refusal import Refusals
from biosensor_common.ros.standard_messages import standard_messages
from biosensor_common.spec import DeviceIdentity, DeviceInfo, StreamSpec
from biosensor_common.stream_header import CoreFields, StreamHeader, foreign_header
from biosensor_common.table import channels, hardware
from biosensor_gateway.devices.registry import declaration, declaration_names
from biosensor_gateway.streaming import outlets
from biosensor_gateway.streaming.outlets import Outlet
from lsl_to_ros.statistics.losses import Lost
from lsl_to_ros.topics.bridge import Outputs
from lsl_to_ros.topics.lanes import Pace, Pacer
from lsl_to_ros.topics.outputs import CLASSES, HAS_STAMPED_TOPICS, open_outputs
from lsl_to_ros.topics.publishers import TopicPublisher, TopicPublishers
from lsl_to_ros.topics.writers import ChunkWriter, NumberWriter, Run, StreamContext
from tests.rigs.recorded_topics import Clocks, header_of

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

# Which topics a stream opens, and that real subscribers get what is written to them.


@pytest.fixture
def publishers(ros: Ros) -> Iterator[TopicPublishers]:
    publishers = TopicPublishers(ros.node, Pacer(Pace(), pytest.fail))
    yield publishers
    publishers.close(lambda _: True)


MUST_NOT_REFUSE = Refusals(pytest.fail)


def context(ros: Ros, header: StreamHeader, base: str) -> StreamContext:
    return StreamContext(
        header=header,
        topic=TopicName(base, header.data_name),
        frame_id=header.identity.sensor,
        stamping=Clocks(ros.node),
        lost=lambda: Lost(0, is_estimated=False),
        refusals=MUST_NOT_REFUSE,
    )


def kinds(outputs: Outputs, base: str) -> dict[str, str]:
    return {
        publisher.topic.removeprefix(f"{base}/"): publisher.type_name
        for publisher in outputs.publishers
    }


STREAMS = [
    (name, stream.data_name) for name in declaration_names() for stream in declaration(name).streams
]


@pytest.mark.parametrize(("sensor_name", "data_name"), STREAMS)
def test_the_topics_of_a_declared_stream(
    ros: Ros, publishers: TopicPublishers, sensor_name: str, data_name: str
) -> None:
    header = header_of(sensor_name, data_name)
    base = f"topics/{sensor_name}"
    outputs = open_outputs(publishers, context(ros, header, base))
    expected = {data_name: header.message_type.value}
    expected |= {each.data: each.type_name for each in standard_messages(header, "")}
    if header.chunk:
        expected[f"{header.chunk}_chunk"] = MessageType.FLOAT32_MULTI_ARRAY.value
    has_time = header.message_type is MessageType.DIAGNOSTIC_ARRAY
    if HAS_STAMPED_TOPICS and not has_time:
        kind = "Event" if header.message_type.is_text else "Samples"
        expected[f"{data_name}_stamped"] = f"biosensor_msgs/msg/{kind}"
    assert kinds(outputs, base) == expected
    assert (outputs.raw is None) == has_time
    latched = {publisher.latched for publisher in outputs.publishers}
    assert latched == {data_name in ("bat", "rssi", "dev")}
    assert outputs.of_samples[0].publisher.topic == f"{base}/{data_name}"


def test_a_declared_chunk_name_is_kept_where_the_topic_has_another_name(
    ros: Ros, publishers: TopicPublishers
) -> None:
    breathing = context(ros, header_of("zephyr", "breathing"), "names/zephyr")
    assert open_outputs(publishers, breathing).publishers[-1].topic == "names/zephyr/br_chunk"
    ecg = context(ros, header_of("zephyr", "ecg"), "names/zephyr")._replace(
        topic=TopicName("names/zephyr", "ecg_x75_U1")
    )
    assert open_outputs(publishers, ecg).publishers[-1].topic == "names/zephyr/ecg_x75_U1_chunk"


@pytest.mark.parametrize(
    ("channel_format", "kind", "chunk"),
    [
        (ChannelFormat.FLOAT32, Float32MultiArray, Float32MultiArray),
        (ChannelFormat.DOUBLE64, Float64MultiArray, Float64MultiArray),
        (ChannelFormat.INT8, Int32MultiArray, Int32MultiArray),
        (ChannelFormat.INT16, Int32MultiArray, Int32MultiArray),
        (ChannelFormat.INT32, Int32MultiArray, Int32MultiArray),
        (ChannelFormat.INT64, Int64MultiArray, Int64MultiArray),
        (ChannelFormat.STRING, String, None),
    ],
)
def test_the_topics_of_another_programs_stream(
    ros: Ros,
    publishers: TopicPublishers,
    channel_format: ChannelFormat,
    kind: type[Any],
    chunk: type[Any] | None,
) -> None:
    core = CoreFields("Cap", "Battery", "id", "host", 1, 100.0, channel_format)
    header = foreign_header(core, ("level",), ("percent",))
    outputs = open_outputs(publishers, context(ros, header, "foreign/cap"))
    found = kinds(outputs, "foreign/cap")
    assert found.pop(header.data_name) == f"std_msgs/msg/{kind.__name__}"
    assert found.pop(f"{header.data_name}_chunk", None) == (
        f"std_msgs/msg/{chunk.__name__}" if chunk else None
    )
    found.pop(f"{header.data_name}_stamped", None)
    # What it measures is not known well enough to say it in a message of sensor_msgs.
    assert found == {}
    assert not any(publisher.latched for publisher in outputs.publishers)


def hear(ros: Ros, publisher: TopicPublisher, kind: type[Any]) -> list[Any]:
    heard = ros.listen(kind, publisher.name)

    def is_read() -> bool:
        publisher.count_readers()
        return publisher.readers == 1

    ros.until(is_read, "a subscriber of our own")
    return heard


@pytest.mark.seam
@pytest.mark.parametrize(
    ("kind", "samples"),
    [
        (MessageType.FLOAT32, np.array([[0.5], [-1.25]], np.float32)),
        (MessageType.UINT8, np.array([[0], [255]], np.int16)),
        (MessageType.UINT16, np.array([[0], [65535]], np.int32)),
        (MessageType.FLOAT32_MULTI_ARRAY, np.array([[0.5, 2.0], [1.0, 3.0]], np.float32)),
        (MessageType.INT64_MULTI_ARRAY, np.array([[2**63 - 1], [-(2**63)]], np.int64)),
    ],
)
def test_subscribers_get_what_was_written_as_bytes(
    ros: Ros, publishers: TopicPublishers, kind: MessageType, samples: NDArray[Any]
) -> None:
    publisher = publishers.open(f"bytes/{kind.name.lower()}", CLASSES[kind])
    heard = hear(ros, publisher, CLASSES[kind])
    writer = NumberWriter(publisher, kind, samples.shape[1], MUST_NOT_REFUSE)
    writer.write(Run(samples, np.arange(1.0, 1.0 + len(samples)), 0))
    ros.until(lambda: len(heard) == len(samples), "every sample")
    data = [list(message.data) if kind.is_array else [message.data] for message in heard]
    assert data == samples.tolist()


@pytest.mark.seam
def test_subscribers_get_chunks(ros: Ros, publishers: TopicPublishers) -> None:
    publisher = publishers.open("bytes/chunk", Float32MultiArray)
    heard = hear(ros, publisher, Float32MultiArray)
    writer = ChunkWriter(publisher, MessageType.FLOAT32_MULTI_ARRAY, 2)
    writer.add(np.array([[1, 2], [3, 4], [5, 6], [7, 8]], np.float32), 2)
    ros.until(lambda: len(heard) == 2, "two chunks")
    assert [list(message.data) for message in heard] == [[1, 2, 3, 4], [5, 6, 7, 8]]


# Values that change seldom are there for whoever subscribes later.
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(autouse=True)
def attached_first(monkeypatch: pytest.MonkeyPatch, node: RunningNode) -> None:
    """The node is there before anything is pushed, so that no sample has to wait for it."""
    assert node.is_running
    monkeypatch.setattr(outlets, "ATTACH_TIME_S", 0.0)


def push(ros: Ros, sensor_name: str, data_name: str, *samples: list[float]) -> tuple[Outlet, str]:
    """Let the node receive samples that nobody reads; return the outlet and its topic."""
    return push_on(ros, declaration(sensor_name).stream(data_name), sensor_name, *samples)


def push_on(
    ros: Ros, stream: StreamSpec, sensor_name: str, *samples: list[float]
) -> tuple[Outlet, str]:
    """The same on any stream."""
    data_name = stream.data_name
    identity = DeviceIdentity(sensor_name, "BH1", participant=f"latched_{data_name}")
    outlet = Outlet(stream, identity, DeviceInfo())
    topic = f"/latched_{data_name}/biosensors/{sensor_name}/{data_name}"
    ros.attached(topic)
    now = pylsl.local_clock()
    stamps = [now - 0.01 * (len(samples) - number) for number in range(len(samples))]
    assert outlet.push(list(samples), stamps) is None

    def has_all() -> bool:
        status = ros.status(topic)
        return status is not None and status["received"] == str(len(samples))

    ros.until(has_all, "every sample in the node")
    return outlet, topic


@pytest.mark.seam
@pytest.mark.parametrize(
    ("sensor_name", "data_name", "kind", "last"),
    [
        ("zephyr", "bat", Float32, [55.0]),
        ("zephyr", "rssi", Float32, [-61.0]),
        (
            "emotiv_insight",
            "dev",
            Float32MultiArray,
            [1.0, 2.0, 3.0, 4.0, 4.0, 4.0, 4.0, 90.0, 80.0],
        ),
    ],
)
def test_a_late_subscriber_gets_the_last_value(
    ros: Ros, sensor_name: str, data_name: str, kind: type[Any], last: list[float]
) -> None:
    _outlet, topic = push(ros, sensor_name, data_name, [9.0] * len(last), last)
    late = ros.listen(kind, topic, LATCHED)
    ros.until(lambda: bool(late), "the last value")
    ros.attached(topic, readers=1)
    ros.report()
    data = [list(message.data) if len(last) > 1 else [message.data] for message in late]
    assert data == [last]


def test_a_late_subscriber_gets_the_last_state_of_the_battery(ros: Ros) -> None:
    _outlet, topic = push(ros, "polar_h10", "bat", [99.0], [55.0])
    late = ros.listen(BatteryState, f"{topic}_state", LATCHED)
    ros.until(lambda: bool(late), "the last state")
    ros.attached(topic, readers=1)
    ros.report()
    assert [message.percentage for message in late] == [pytest.approx(0.55)]
    assert math.isnan(late[0].voltage)


def test_a_state_of_a_sensor_that_nobody_has_heard_of_is_kept(ros: Ros) -> None:
    mode = hardware("mode", ContentType.STATUS, channels("mmHg", "limit"), is_state=True)
    _outlet, topic = push_on(ros, mode, "never_heard_of", [99.0], [55.0])
    late = ros.listen(Float32, topic, LATCHED)
    ros.until(lambda: bool(late), "the last value")
    assert [message.data for message in late] == [55.0]


def test_what_changes_often_is_not_kept(ros: Ros) -> None:
    outlet, topic = push(ros, "zephyr", "posture", [99.0], [55.0])
    late = ros.listen(Float32, topic)
    ros.attached(topic, readers=1)
    assert outlet.push([12.0], [pylsl.local_clock()]) is None
    ros.until(lambda: bool(late), "what came after the subscription")
    assert [message.data for message in late] == [12.0]


def test_a_late_subscriber_gets_the_list_of_streams(ros: Ros) -> None:
    _outlet, topic = push(ros, "empatica_e4", "bat", [55.0])
    late = ros.listen(DiagnosticArray, "/lsl_to_ros/streams", LATCHED)

    def is_listed() -> bool:
        return any(status.name == topic for message in late for status in message.status)

    ros.until(is_listed, "the list, with this stream")
