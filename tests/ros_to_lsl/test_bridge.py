"""What becomes of a topic's messages, up to the outlet."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, cast
from xml.etree import ElementTree

import pylsl
import pytest
from rclpy.serialization import serialize_message
from rosidl_parser import definition

from lsl_to_ros.ros_to_lsl import topic_bridge, topic_outlets
from lsl_to_ros.ros_to_lsl.class_fields import message_class, type_name
from lsl_to_ros.ros_to_lsl.graph import Topic
from lsl_to_ros.ros_to_lsl.parameters import SendAs, TopicRequest
from lsl_to_ros.ros_to_lsl.reports import topic_facts, topic_status
from lsl_to_ros.ros_to_lsl.stamps import Offset, StampSource
from lsl_to_ros.ros_to_lsl.topic_bridge import Bridge, MessageType
from lsl_to_ros.statistics.ros_time import RosTime
from lsl_to_ros.statistics.status import StreamStatus
from lsl_to_ros.subscriber_thread import has_nul, steps_of
from tests.rigs.memory_links import MemoryOutlet
from tests.ros_to_lsl.conftest import MILLISECOND, NOW_NS, info, stamped

# Their own annotations are partial.
PoseArray = message_class("geometry_msgs/msg/PoseArray")
Pose = message_class("geometry_msgs/msg/Pose")
PoseStamped = message_class("geometry_msgs/msg/PoseStamped")
Point = message_class("geometry_msgs/msg/Point")
TransformStamped = message_class("geometry_msgs/msg/TransformStamped")
Float64MultiArray = message_class("std_msgs/msg/Float64MultiArray")
UInt8MultiArray = message_class("std_msgs/msg/UInt8MultiArray")
MultiArrayDimension = message_class("std_msgs/msg/MultiArrayDimension")
OK, WARN, ERROR = b"\0", b"\1", b"\2"


# Its own annotations are partial, too.
_definition: Any = definition
_TRANSFORM = _definition.NamespacedType(["geometry_msgs", "msg"], "TransformStamped")


class TFMessage:
    """As tf2_msgs has it, which may not be installed."""

    SLOT_TYPES = (_definition.UnboundedSequence(_TRANSFORM),)
    __module__ = "tf2_msgs.msg"

    def __init__(self, transforms: Sequence[Any] = ()) -> None:
        self.transforms = list(transforms)

    @staticmethod
    def get_fields_and_field_types() -> dict[str, str]:
        return {"transforms": "sequence<geometry_msgs/TransformStamped>"}


class Outlet(MemoryOutlet):
    """Keeps what was pushed."""

    def __init__(self, described: pylsl.StreamInfo) -> None:
        super().__init__(described)
        self.info = described
        self.pushed: list[tuple[list[Any], float]] = []
        self.is_received = True
        opened[described.name()] = self

    def push_sample(self, x: Any, timestamp: float = 0.0, pushthrough: bool = True) -> None:
        super().push_sample(x, timestamp, pushthrough)
        self.pushed.append((list(x), timestamp))

    def have_consumers(self) -> bool:
        return self.is_received

    @property
    def values(self) -> list[list[Any]]:
        return [values for values, _ in self.pushed]


opened: dict[str, Outlet] = {}


def _to_s(ns: int) -> float:
    return (ns - NOW_NS) / 1e9


class Sent:
    """A topic, its bridge, and what was said of it."""

    def __init__(self, topic: str, kind: Any, **request: Any) -> None:
        self.said: list[str] = []
        seconds = SimpleNamespace(to_lsl_s=_to_s)
        self.bridge = Bridge(
            TopicRequest(topic, topic.strip("/"), **request),
            cast("RosTime", seconds),
            self.said.append,
            by_arrival=False,
        )
        self.kind = MessageType(type_name(kind), "", kind)
        self.bridge.connect(self.kind)

    def take(self, message: Any, at_ms: int = 0) -> None:
        self.bridge.take(message, info(NOW_NS + at_ms * MILLISECOND))

    def run(self, make: Callable[[], Any], *, header_s: float, source_s: float) -> None:
        """Take messages for some seconds whose stamps are so much older than their arrival."""
        for number in range(80):
            at_ns = NOW_NS + number * 50 * MILLISECOND
            message = stamped(make(), at_ns - round(header_s * 1e9))
            self.bridge.take(message, info(at_ns - round(source_s * 1e9), round(source_s * 1e9)))

    def status(self) -> Any:
        topic = SimpleNamespace(
            bridge=self.bridge,
            status=StreamStatus(),
            kind=self.kind,
            name="/t",
            publishers=1,
            quality="reliable",
        )
        return topic_status(cast("Topic", topic))


@pytest.fixture(autouse=True)
def kept(monkeypatch: pytest.MonkeyPatch) -> None:
    opened.clear()
    monkeypatch.setattr(topic_outlets, "LslOutlet", Outlet)


def transform(parent: str, child: str, x: float, at_ms: int = 0) -> Any:
    message = stamped(TransformStamped(child_frame_id=child), NOW_NS + at_ms * MILLISECOND)
    message.header.frame_id = parent
    message.transform.translation.x = x
    return message


def test_a_multiarray_is_samples_and_keeps_what_is_no_number() -> None:
    sent = Sent("/cmd", Float64MultiArray)
    sent.take(Float64MultiArray(data=[1.5, math.nan, -math.inf]))
    labelled = Float64MultiArray(data=[2.5, 3.5, math.inf])
    labelled.layout.dim = [MultiArrayDimension(label="joints", size=3, stride=3)]
    sent.take(labelled, 10)
    assert list(opened) == ["cmd"]
    first, second = opened["cmd"].values
    assert (first[0], math.isnan(first[1]), first[2]) == (1.5, True, -math.inf)
    assert second == [2.5, 3.5, math.inf]
    assert opened["cmd"].info.channel_count() == 3
    assert sent.said == []


def test_bytes_of_a_multiarray_are_numbers_that_somebody_chose() -> None:
    sent = Sent("/leds", UInt8MultiArray)
    sent.take(UInt8MultiArray(data=[1, 255]))
    assert opened["leds"].values == [[1, 255]]


BULK = ["PointCloud2", "PointCloud", "Image", "CompressedImage"]


@pytest.mark.parametrize("name", [f"sensor_msgs/msg/{each}" for each in BULK])
@pytest.mark.parametrize("send_as", list(SendAs))
def test_bulk_data_is_refused_by_name_however_it_is_asked_for(name: str, send_as: SendAs) -> None:
    kind = message_class(name)
    sent = Sent("/bulk", kind, send_as=send_as)
    sent.take(kind())
    assert not sent.bridge.streams
    (sentence,) = sent.said
    assert "bulk data" in sentence
    assert "ros2 bag" in sentence
    status = sent.status()
    assert (status.level, status.message) == (ERROR, sentence)


def test_other_fields_of_bulk_data_can_be_sent() -> None:
    image = message_class("sensor_msgs/msg/Image")
    sent = Sent("/camera", image, fields=("width", "height"))
    sent.take(image(width=640, height=480, data=[0] * 9000))
    assert opened["camera"].values == [[480, 640]]
    assert "bulk data" in Sent("/camera", image, fields=("width", "data")).said[0]


def test_each_pair_of_frames_is_a_stream_with_its_own_stamps() -> None:
    sent = Sent("/tf", TFMessage)
    sent.take(TFMessage(transforms=[transform("odom", "base_link", 1.0)]))
    both = [transform("map", "odom", 5.0, at_ms=3), transform("odom", "base_link", 2.0, at_ms=9)]
    sent.take(TFMessage(transforms=both), 9)
    assert list(opened) == ["tf-odom-base_link", "tf-map-odom"]
    base = opened["tf-odom-base_link"]
    assert base.info.channel_count() == 7
    assert [values[0] for values in base.values] == [1.0, 2.0]
    assert [round(stamp, 6) for _, stamp in base.pushed] == [0.0, 0.009]
    assert [round(stamp, 6) for _, stamp in opened["tf-map-odom"].pushed] == [0.003]
    header = ElementTree.fromstring(base.info.as_xml())
    assert header.findtext("desc/ros/frame_id") == "odom"
    assert header.findtext("desc/ros/child_frame_id") == "base_link"
    assert sent.bridge.streams == {"tf-odom-base_link": 2, "tf-map-odom": 1}
    assert (sent.status().level, sent.said) == (OK, [])


def test_frames_with_slashes_never_share_a_stream() -> None:
    sent = Sent("/tf", TFMessage)
    sent.take(TFMessage(transforms=[transform("a/b", "c", 1.0), transform("a", "b/c", 2.0)]))
    assert list(opened) == ["tf-a-b-c", "tf-a-b-c-2"]


def test_more_pairs_than_there_may_be_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topic_bridge, "MAX_PAIRS", 2)
    sent = Sent("/tf", TFMessage)
    many = [transform("camera", f"face_{number}", 1.0) for number in range(4)]
    sent.take(TFMessage(transforms=many))
    sent.take(TFMessage(transforms=many), 10)
    assert len(opened) == 2
    (sentence,) = sent.said
    assert "2 pairs of frames" in sentence
    assert (sent.status().level, sent.status().message) == (WARN, sentence)


def test_what_is_latched_is_repeated_for_who_comes_later() -> None:
    sent = Sent("/tf_static", TFMessage)
    sent.bridge.is_latched = True
    sent.take(TFMessage(transforms=[transform("base_link", "laser", 0.25)]))
    outlet = opened["tf_static-base_link-laser"]
    outlet.is_received = False
    sent.bridge.look(1.0)
    outlet.is_received = True
    sent.bridge.look(2.0)
    sent.bridge.look(3.0)
    assert [values[0] for values in outlet.values] == [0.25, 0.25]
    assert outlet.pushed[-1][1] == 2.0


def test_elements_wanted_by_number_are_sent_however_many_there_are() -> None:
    sent = Sent("/people", PoseArray, fields=("poses[0].position",))
    for number, count in enumerate((1, 3, 2, 0) * 10):
        poses = [Pose(position=Point(x=float(count)))] * count
        sent.take(PoseArray(poses=poses), number)
    values = [each[0] for each in opened["people"].values[:4]]
    assert values[:3] == [1.0, 3.0, 2.0]
    assert math.isnan(values[3])
    assert (sent.said, sent.bridge.replaced) == ([], 0)


def test_a_topic_whose_messages_have_no_numbers_yet_is_not_sending() -> None:
    sent = Sent("/people", PoseArray)
    for number in range(3):
        sent.take(PoseArray(), number)
    status = sent.status()
    assert (status.level, status.message) == (WARN, "no numbers yet: its messages contained none")
    (sentence,) = sent.said
    assert sentence.startswith(status.message)
    sent.take(PoseArray(poses=[Pose()]), 5)
    assert (sent.status().level, sent.status().message) == (OK, "sending")


def test_transforms_that_list_nothing_are_no_number_either() -> None:
    sent = Sent("/tf", TFMessage)
    sent.take(TFMessage())
    assert sent.status().message.startswith("no numbers yet")


CLOCKS = [
    # Older than their arrival by: header, source; what is used, what the header says.
    (0.0003, 0.0002, "header", "synchronised", OK),
    (0.1, 0.0002, "header", "behind", WARN),
    (0.5, 0.5, "arrival", "behind", WARN),
    (5.0, 0.0002, "source", "wrong", WARN),
    (-0.01, -0.01, "arrival", "wrong", WARN),
]


@pytest.mark.parametrize(("header_s", "source_s", "used", "word", "level"), CLOCKS)
def test_only_a_clock_that_is_known_to_be_right_is_believed(
    header_s: float, source_s: float, used: str, word: str, level: bytes
) -> None:
    sent = Sent("/arm", PoseStamped)
    sent.run(PoseStamped, header_s=header_s, source_s=source_s)
    header = ElementTree.fromstring(opened["arm"].info.as_xml())
    assert header.findtext("desc/ros/stamp_source") == used
    assert header.findtext("desc/ros/clock") == word
    assert float(header.findtext("desc/ros/clock_edge_s", "")) == pytest.approx(header_s, abs=0.001)
    last_s = opened["arm"].pushed[-1][1]
    late_s = {"header": header_s, "source": source_s, "arrival": 0.0}[used]
    assert last_s == pytest.approx(79 * 0.05 - late_s, abs=1e-6)
    assert sent.status().level == level
    heard = topic_facts(cast("Topic", SimpleNamespace(bridge=sent.bridge)))
    clocks = cast("dict[str, dict[str, Any]]", heard["clocks"])
    assert clocks["header"]["state"] == word
    assert clocks["source"]["edge_s"] == pytest.approx(source_s, abs=0.001)


def test_the_header_names_topic_and_type() -> None:
    Sent("/arm", PoseStamped).run(PoseStamped, header_s=0.5, source_s=0.5)
    header = ElementTree.fromstring(opened["arm"].info.as_xml())
    assert header.findtext("desc/ros/topic") == "/arm"
    assert header.findtext("desc/ros/type") == "geometry_msgs/msg/PoseStamped"


def test_what_was_measured_of_a_publisher_is_said() -> None:
    sent = Sent("/arm", PoseStamped)
    sent.run(PoseStamped, header_s=0.5, source_s=0.5)
    assert "behind by up to 0.500 s" in sent.status().message
    assert sent.bridge.stamping.wants_offset
    sent.bridge.take_offset(Offset(-0.5005, -0.4995))
    assert "clock of its publisher is 0.500 s behind this computer's time" in sent.status().message


def test_a_slow_way_is_no_wrong_clock_once_it_was_measured() -> None:
    sent = Sent("/arm", PoseStamped)
    sent.run(PoseStamped, header_s=0.2, source_s=0.2)
    sent.bridge.take_offset(Offset(-0.001, 0.001))
    before = sent.bridge.stamping.sources[StampSource.HEADER]
    sent.run(PoseStamped, header_s=0.2, source_s=0.2)
    assert sent.bridge.stamping.sources[StampSource.HEADER] == before + 80


# Texts with a NUL character, which rclpy itself cannot publish.


def _serialised(kind: str, **values: Any) -> tuple[type[Any], bytes]:
    message = message_class(kind)(**values)
    return message_class(kind), serialize_message(message)


KEY_VALUES = [message_class("diagnostic_msgs/msg/KeyValue")(key="speed", value="xNUL")]
JOINTS = {"name": ["arm", "xNUL"], "position": [0.5, 0.25], "effort": [1.0]}
TEXTS: dict[str, dict[str, Any]] = {
    "std_msgs/msg/String": {"data": "xNUL"},
    "diagnostic_msgs/msg/KeyValue": {"key": "a", "value": "xNUL"},
    "diagnostic_msgs/msg/DiagnosticStatus": {
        "level": b"\1",
        "name": "odd",
        "message": "a",
        "values": KEY_VALUES,
    },
    "sensor_msgs/msg/JointState": JOINTS,
    "rcl_interfaces/msg/Log": {"level": 20, "name": "node", "msg": "xNUL", "line": 7},
    "std_msgs/msg/Float64MultiArray": {"data": [1.0, 2.0]},
}


@pytest.mark.parametrize("kind", TEXTS)
def test_a_nul_in_any_text_of_a_message_is_found_and_no_other_is(kind: str) -> None:
    found, content = _serialised(kind, **TEXTS[kind])
    steps = steps_of(found)
    assert not has_nul(content, steps)
    with_nul = content.replace(b"xNUL", b"x\0UL")
    assert has_nul(with_nul, steps) == (with_nul != content)
    # What is cut short is somebody else's error, and other encodings are not followed.
    assert not has_nul(content[:5], steps)
    assert not has_nul(b"\0\7" + with_nul[2:], steps)


def test_numbers_alone_are_not_taken_as_bytes() -> None:
    assert steps_of(message_class("std_msgs/msg/Float64")) == ()
    assert steps_of(Pose) == ()
