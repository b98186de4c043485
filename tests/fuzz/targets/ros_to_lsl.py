"""Parameters of ``ros_to_lsl``, and messages of any type as the middleware hands them over.

A line of JSON has the parameters, pieces after it the messages: a byte for the type, then the
bytes that were received. Each number stands in the channel whose label tells where it is in the
message, headers are XML, and markers are text that any program can read.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from typing import Any, cast
from xml.etree import ElementTree as ET

from rclpy.exceptions import InvalidTopicNameException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.validate_full_topic_name import validate_full_topic_name

from biosensor_common.errors import ConfigError, SpecError
from biosensor_common.ros.fields import Field
from biosensor_common.ros.layout import Layout, LayoutChangedError
from lsl_to_ros.ros_to_lsl.class_fields import fields_of, has_header, message_class
from lsl_to_ros.ros_to_lsl.parameters import Requests, requests_of
from lsl_to_ros.ros_to_lsl.senders import ToText, as_json, is_text, marker_of, text_of
from lsl_to_ros.ros_to_lsl.topic_outlets import Origin, sample_info
from tests.fuzz.contract import ensure
from tests.fuzz.streams import counted_pieces

TYPES = (
    "sensor_msgs/msg/JointState",
    "nav_msgs/msg/Odometry",
    "diagnostic_msgs/msg/DiagnosticArray",
    "std_msgs/msg/String",
    "trajectory_msgs/msg/MultiDOFJointTrajectory",
    "sensor_msgs/msg/BatteryState",
    "std_msgs/msg/UInt64",
    "std_msgs/msg/Float64MultiArray",
    "std_msgs/msg/ByteMultiArray",
    "std_msgs/msg/Empty",
    "diagnostic_msgs/msg/DiagnosticStatus",
    "geometry_msgs/msg/PoseArray",
    "trajectory_msgs/msg/JointTrajectory",
    "sensor_msgs/msg/PointCloud2",
)
"""One of each shape; the place of a type is its number in an input."""
CLASSES = tuple(message_class(name) for name in TYPES)
for _each in CLASSES:
    # What it imports warns, and warnings are finds later.
    serialize_message(_each())
# More make LSL's description slow, and are no other shape.
_MOST_DESCRIBED = 64
_LONGEST_INTEGER = 2**63
_NAME = re.compile(r"[A-Za-z0-9_-]{1,100}")
_INDEX = re.compile(r"\.?([^.\[]+)|\[(\d+)\]")
_XML_TEXT = re.compile("[\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]*")


def check(data: bytes) -> None:
    """Read the parameters, then send the messages as the first topic is asked for."""
    line, _, rest = data.partition(b"\n")
    requests = _requests(line)
    first = requests.topics[0] if requests and requests.topics else None
    wanted = first.fields if first else ()
    layouts: dict[type[Any], Layout] = {}
    for piece in counted_pieces(rest):
        message = _message(piece)
        if message is not None:
            _numbers(message, wanted, layouts)
            _texts(message, wanted)


def _requests(line: bytes) -> Requests | None:
    try:
        given = json.loads(line.decode())
    except (ValueError, RecursionError):
        return None
    if not isinstance(given, dict) or not _is_of_ros(cast("object", given)):
        return None
    try:
        requests = requests_of(cast("dict[str, Any]", given), _resolve)
    except ConfigError as error:
        ensure(str(error) != "" and "\n" not in str(error), "not one sentence", error)
        return None
    names = [each.name for each in requests.topics]
    ensure(len(set(names)) == len({each.topic for each in requests.topics}), "one name", names)
    for each in requests.topics:
        ensure(_NAME.fullmatch(each.name) is not None, "no name", each)
        ensure(math.isfinite(each.rate) and each.rate >= 0, "no rate", each)
        validate_full_topic_name(each.topic)
    return requests


def _is_of_ros(value: object) -> bool:
    """Whether ROS can have it as parameters: UTF-8, and integers of 64 bits."""
    if isinstance(value, dict):
        items = cast("dict[str, object]", value).items()
        return all(_is_of_ros(name) and _is_of_ros(each) for name, each in items)
    if isinstance(value, list):
        return all(map(_is_of_ros, cast("list[object]", value)))
    if isinstance(value, str):
        return not any("\ud800" <= each <= "\udfff" for each in value)
    return not isinstance(value, int) or abs(value) < _LONGEST_INTEGER


def _resolve(topic: str) -> str:
    full = expand_topic_name(topic, "ros_to_lsl", "/arm")
    try:
        validate_full_topic_name(full)
    except InvalidTopicNameException as error:
        # A node's own resolving makes a RuntimeError of it; without a node, rclpy has two classes.
        raise ValueError(str(error)) from error
    return full


def _message(piece: bytes) -> Any:
    if not piece or piece[0] >= len(CLASSES):
        return None
    try:
        return deserialize_message(piece[1:], CLASSES[piece[0]])
    # The middleware's own, by which it drops a message; it has no other class.
    except Exception as error:
        if type(error).__name__ == "RMWError":
            return None
        raise


def _numbers(message: Any, wanted: Sequence[str], layouts: dict[type[Any], Layout]) -> None:
    kind: type[Any] = message.__class__
    fields = fields_of(kind)
    try:
        before = layouts.get(kind)
        layout = before or Layout(fields, message, wanted)
        values = layout.read(message)
    except SpecError as error:
        ensure(str(error) != "", "a refusal without a reason", wanted)
        return
    except LayoutChangedError:
        ensure(kind in layouts, "a layout does not fit its own message", message)
        layouts.pop(kind)
        _numbers(message, wanted, layouts)
        return
    layouts[kind] = layout
    ensure(len(values) == len(layout.channels), "not one number a channel", layout.labels)
    ensure(len(set(layout.labels)) == len(layout.labels), "two channels of one label")
    for channel, value in zip(layout.channels, values, strict=True):
        if before is None:
            _is_from(message, channel.path, value)
    layout.inexact(values)
    if before is None and 0 < len(layout.channels) <= _MOST_DESCRIBED:
        _described(message, layout)


def _is_from(message: Any, path: str, value: float) -> None:
    """Compare a number with what is at its path, by the path alone."""
    at = message
    for name, index in _INDEX.findall(path):
        at = at[int(index)] if index else getattr(at, name)
    if hasattr(at, "nanosec"):
        at = at.sec + at.nanosec * 1e-9
    at = at[0] if isinstance(at, bytes) else at
    ensure(value == at or (math.isnan(value) and math.isnan(at)), "another number", path, value, at)


def _described(message: Any, layout: Layout) -> None:
    frames = {"frame_id": message.header.frame_id} if has_header(message.__class__) else {}
    origin = Origin("/a", "a/msg/B", frames=frames)
    info = sample_info("a", origin, layout.channels, 0.0)
    root = ET.fromstring(info.as_xml())
    labels = [each.text or "" for each in root.iterfind("desc/channels/channel/label")]
    ensure(len(labels) == len(layout.labels), "other channels in the header", labels)
    for told, label in zip(labels, layout.labels, strict=True):
        if _XML_TEXT.fullmatch(label) and "\r" not in label:
            ensure(told == label, "another label in the header", told, label)


def _texts(message: Any, wanted: Sequence[str]) -> None:
    kind: type[Any] = message.__class__
    json.loads(as_json(message))
    for make in (marker_of(kind, "/topic"), _text_reader(fields_of(kind), wanted)):
        if make is not None:
            make(message).encode()


def _text_reader(fields: Sequence[Field], wanted: Sequence[str]) -> ToText | None:
    try:
        return text_of(fields, wanted)
    except SpecError as error:
        is_due = wanted or not any(map(is_text, fields))
        ensure(bool(is_due), "there is text, and none is found", error)
        return None
