"""Parameters of ``ros_to_lsl``, and the markers that it makes of messages."""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rclpy.node import Node
from rclpy.parameter import Parameter

from biosensor_common.errors import ConfigError, ConfigReason, SpecError, SpecReason
from biosensor_common.ros.fields import all_fields
from biosensor_common.ros.layout import Layout, LayoutChangedError
from lsl_to_ros.ros_to_lsl.class_fields import fields_of, message_class, type_name
from lsl_to_ros.ros_to_lsl.parameters import (
    NODE_OPTIONS,
    TOPIC_OPTIONS,
    Requests,
    SendAs,
    TopicRequest,
    read_requests,
    usage,
)
from lsl_to_ros.ros_to_lsl.senders import as_json, has_records, is_text, marker_of, text_of

# What the parameters mean, and one sentence for each that is wrong.

MakeNode = Callable[..., Node]
EXAMPLE = Path(__file__).parents[2] / "ros_side" / "lsl_to_ros" / "config" / "ros_to_lsl.yaml"


def read(make_node: MakeNode, given: dict[str, Any], namespace: str = "") -> Requests:
    node = make_node(
        "parameters",
        namespace=namespace,
        allow_undeclared_parameters=True,
        automatically_declare_parameters_from_overrides=True,
        parameter_overrides=[Parameter(name, value=value) for name, value in given.items()],
    )
    requests = read_requests(node, node.resolve_topic_name)
    assert all(node.has_parameter(name) for name in NODE_OPTIONS)
    return requests


def flat(values: dict[str, Any], before: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            found |= flat(cast("dict[str, Any]", value), f"{before}{name}.")
        else:
            found[f"{before}{name}"] = value
    return found


@pytest.mark.nightly
def test_a_topic_needs_no_more_than_its_name(make_node: MakeNode) -> None:
    requests = read(make_node, {"topics": ["/robot/odom", "joint_states"]}, namespace="/arm")
    assert requests == Requests(
        (
            TopicRequest("/robot/odom", "robot-odom"),
            TopicRequest("/arm/joint_states", "arm-joint_states"),
        )
    )


@pytest.mark.nightly
def test_the_example_is_read_as_its_comments_say(make_node: MakeNode) -> None:
    (content,) = yaml.safe_load(EXAMPLE.read_text()).values()
    requests = read(make_node, flat(content["ros__parameters"]))
    assert requests.topics == (
        TopicRequest("/joint_states", "joint_states"),
        TopicRequest("/odom", "robot_pose", fields=("pose.pose.position", "pose.pose.orientation")),
        TopicRequest(
            "/robot/event", "robot-event", SendAs.MARKERS, type_name="std_msgs/msg/String"
        ),
    )


def test_the_example_has_every_parameter() -> None:
    text = EXAMPLE.read_text()
    assert all(f" {name}:" in text or f"#{name}:" in text for name in NODE_OPTIONS)
    assert all(f" {name}:" in text or f"#{name}:" in text for name in TOPIC_OPTIONS)


@pytest.mark.nightly
def test_simulated_time_can_be_stamped_by_arrival(make_node: MakeNode) -> None:
    given = {"topics": ["/a"], "use_sim_time": True, "stamps": "arrival"}
    assert read(make_node, given).by_arrival


WRONG: list[tuple[dict[str, Any], ConfigReason, str]] = [
    ({}, ConfigReason.NOT_FOUND, "all_small"),
    ({"topics": [""]}, ConfigReason.NOT_FOUND, "all_small"),
    ({"topics": "/odom"}, ConfigReason.WRONG_VALUE, "topics must be a list"),
    ({"topics": [1, 2]}, ConfigReason.WRONG_VALUE, "topics must be a list"),
    ({"topics": ["/a", "/a"]}, ConfigReason.WRONG_VALUE, "twice"),
    ({"topics": ["/a b"]}, ConfigReason.WRONG_VALUE, "not a topic name"),
    ({"topics": ["a.b"]}, ConfigReason.WRONG_VALUE, "not a topic name"),
    ({"topics": ["/a//b"]}, ConfigReason.WRONG_VALUE, "not a topic name"),
    ({"topics": ["/a/{ns}"]}, ConfigReason.WRONG_VALUE, "not a topic name"),
    ({"topics": ["/" + "a" * 300]}, ConfigReason.WRONG_VALUE, "not a topic name"),
    ({"topics": ["/a"], "topic": ["/b"]}, ConfigReason.UNKNOWN_KEY, "topic is not a parameter"),
    ({"topics": ["/a"], "/b.rate": 5.0}, ConfigReason.UNKNOWN_KEY, "/b is not among"),
    ({"topics": ["/a"], "a.rate": 5.0}, ConfigReason.UNKNOWN_KEY, "same spelling"),
    ({"topics": ["/a"], "/a.rates": 5.0}, ConfigReason.UNKNOWN_KEY, "no 'rates'"),
    ({"topics": ["/a"], "/a.as": "text"}, ConfigReason.WRONG_VALUE, "samples, markers or json"),
    ({"topics": ["/a"], "/a.as": 1}, ConfigReason.WRONG_VALUE, "/a.as must be text"),
    ({"topics": ["/a"], "/a.rate": 1e12}, ConfigReason.WRONG_VALUE, "from 0 to 10000 Hz"),
    ({"topics": ["/a"], "/a.rate": -1.0}, ConfigReason.WRONG_VALUE, "/a.rate"),
    ({"topics": ["/a"], "/a.rate": float("nan")}, ConfigReason.WRONG_VALUE, "/a.rate"),
    ({"topics": ["/a"], "/a.rate": True}, ConfigReason.WRONG_VALUE, "a number"),
    ({"topics": ["/a"], "/a.fields": "x"}, ConfigReason.WRONG_VALUE, "a list"),
    ({"topics": ["/a"], "/a.name": "a b"}, ConfigReason.WRONG_VALUE, "/a.name"),
    ({"topics": ["/a"], "/a.name": "it's"}, ConfigReason.WRONG_VALUE, "/a.name"),
    ({"topics": ["/a"], "/a.type": "String"}, ConfigReason.WRONG_VALUE, "std_msgs/msg/String"),
    (
        {"topics": ["/a", "/b"], "/a.name": "x", "/b.name": "x"},
        ConfigReason.WRONG_VALUE,
        "/a and /b would both",
    ),
    ({"all_small": "yes"}, ConfigReason.WRONG_VALUE, "true or false"),
    ({"all_small": True, "stamps": "now"}, ConfigReason.WRONG_VALUE, "measured or arrival"),
    ({"all_small": True, "use_sim_time": True}, ConfigReason.WRONG_VALUE, "stamps:=arrival"),
    ({"all_small": True, "session_id": 4}, ConfigReason.WRONG_VALUE, "session_id must be text"),
]


@pytest.mark.nightly
@pytest.mark.parametrize(("given", "reason", "words"), WRONG, ids=lambda each: str(each)[:40])
def test_what_is_wrong_is_said_in_one_sentence(
    make_node: MakeNode, given: dict[str, Any], reason: ConfigReason, words: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        read(make_node, given)
    assert caught.value.reason is reason
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_help_fits_a_console_and_names_every_parameter() -> None:
    lines = usage().splitlines()
    assert max(map(len, lines)) <= 80
    text = "\n".join(lines)
    assert all(f"  {name} " in text for name in NODE_OPTIONS)
    assert all(f"TOPIC.{name} " in text for name in TOPIC_OPTIONS)


# Markers of messages.
# Their own annotations are partial.
DiagnosticArray = message_class("diagnostic_msgs/msg/DiagnosticArray")
DiagnosticStatus = message_class("diagnostic_msgs/msg/DiagnosticStatus")
KeyValue = message_class("diagnostic_msgs/msg/KeyValue")
Odometry = message_class("nav_msgs/msg/Odometry")
BatteryState = message_class("sensor_msgs/msg/BatteryState")
JointState = message_class("sensor_msgs/msg/JointState")
Empty = message_class("std_msgs/msg/Empty")
Int32 = message_class("std_msgs/msg/Int32")
String = message_class("std_msgs/msg/String")


def test_a_message_of_one_field_is_that_field() -> None:
    assert marker_of(String, "/trial")(String(data="go")) == "go"
    assert marker_of(Int32, "/trigger")(Int32(data=7)) == "7"


def test_a_message_without_fields_is_the_name_of_its_topic() -> None:
    assert marker_of(Empty, "/trial/start")(Empty()) == "/trial/start"


def test_a_message_of_many_fields_is_json() -> None:
    message = DiagnosticStatus(
        level=DiagnosticStatus.WARN, name="arm", values=[KeyValue(key="a", value="1")]
    )
    assert json.loads(marker_of(DiagnosticStatus, "/status")(message)) == {
        "level": 1,
        "name": "arm",
        "message": "",
        "hardware_id": "",
        "values": [{"key": "a", "value": "1"}],
    }


def test_what_is_no_number_is_a_word() -> None:
    message = JointState(name=["a"], position=array("d", [math.nan]), effort=array("d", [math.inf]))
    content = json.loads(as_json(message))
    assert (content["position"], content["effort"], content["velocity"]) == (
        ["NaN"],
        ["Infinity"],
        [],
    )
    assert content["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}


def test_fields_can_be_chosen() -> None:
    message = DiagnosticStatus(name="arm", message="hot")
    assert marker_of(DiagnosticStatus, "/s", ["message"])(message) == "hot"
    both = marker_of(DiagnosticStatus, "/s", ["name", "message"])(message)
    assert json.loads(both) == {"name": "arm", "message": "hot"}
    with pytest.raises(SpecError, match=r"'massage'.*message"):
        marker_of(DiagnosticStatus, "/s", ["massage"])


def test_text_beside_numbers_is_text_and_enumerations_by_their_names() -> None:
    message = BatteryState(
        power_supply_status=BatteryState.POWER_SUPPLY_STATUS_FULL, serial_number="B7"
    )
    content = json.loads(text_of(fields_of(BatteryState))(message))
    assert content["power_supply_status"] == "FULL"
    assert content["serial_number"] == "B7"
    assert "voltage" not in content


def test_frames_and_names_of_joints_are_no_text_of_their_own() -> None:
    for kind in (Odometry, JointState):
        assert not any(is_text(each) for each in fields_of(kind))


def test_a_list_of_reports_is_known_for_one() -> None:
    assert has_records(fields_of(DiagnosticArray))
    assert not has_records(fields_of(JointState))


@given(text=st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0")))
def test_any_text_passes(text: str) -> None:
    assert marker_of(String, "/t")(String(data=text)) == text
    assert json.loads(as_json(String(data=text))) == {"data": text}


# Numbers of messages as channels.

# Their own annotations are partial.
Duration = message_class("builtin_interfaces/msg/Duration")
Point = message_class("geometry_msgs/msg/Point")
Pose = message_class("geometry_msgs/msg/Pose")
PoseArray = message_class("geometry_msgs/msg/PoseArray")
TwistStamped = message_class("geometry_msgs/msg/TwistStamped")
WrenchStamped = message_class("geometry_msgs/msg/WrenchStamped")
Imu = message_class("sensor_msgs/msg/Imu")
MultiDOFJointState = message_class("sensor_msgs/msg/MultiDOFJointState")
Wrench = message_class("geometry_msgs/msg/Wrench")
LaserScan = message_class("sensor_msgs/msg/LaserScan")
Bool = message_class("std_msgs/msg/Bool")
Header = message_class("std_msgs/msg/Header")
UInt64 = message_class("std_msgs/msg/UInt64")
JointTrajectory = message_class("trajectory_msgs/msg/JointTrajectory")
JointTrajectoryPoint = message_class("trajectory_msgs/msg/JointTrajectoryPoint")


def layout_of(message: Any, *wanted: str) -> Layout:
    return Layout(fields_of(message.__class__), message, wanted)


def joints(*names: str, **values: Any) -> Any:
    arrays = {name: array("d", each) for name, each in values.items()}
    return JointState(name=list(names), **arrays)


def test_fields_of_messages_inside_stand_with_their_paths() -> None:
    layout = layout_of(Odometry())
    assert layout.labels[:7] == (
        *(f"pose.pose.position.{axis}" for axis in "xyz"),
        *(f"pose.pose.orientation.{axis}" for axis in "xyzw"),
    )
    # Pose, twist and a covariance of 36 each; neither the header nor the other frame.
    assert len(layout.labels) == 7 + 36 + 6 + 36


def test_values_stand_in_the_order_of_their_labels() -> None:
    message = Odometry()
    message.pose.pose.position.y, message.twist.twist.angular.z = 2.5, -1.0
    message.pose.covariance[35] = 9.0
    layout = layout_of(message)
    values = dict(zip(layout.labels, layout.read(message), strict=True))
    assert values["pose.pose.position.y"] == 2.5
    assert values["twist.twist.angular.z"] == -1.0
    assert values["pose.covariance[35]"] == 9.0
    assert values["pose.pose.orientation.w"] == 1.0
    assert sum(value != 0 for value in values.values()) == 4


@pytest.mark.parametrize(
    ("message", "label", "unit", "kind"),
    [
        (Odometry(), "pose.pose.position.x", "m", "PositionX"),
        (Odometry(), "pose.pose.orientation.w", "none", "OrientationA"),
        (Odometry(), "pose.pose.orientation.z", "none", "OrientationD"),
        (Odometry(), "twist.twist.linear.y", "m/s", "VelocityY"),
        (Odometry(), "twist.twist.angular.z", "rad/s", "AngularVelocityZ"),
        (Odometry(), "pose.covariance[0]", "", ""),
        (TwistStamped(), "twist.linear.x", "m/s", "VelocityX"),
        (WrenchStamped(), "wrench.force.z", "N", "ForceZ"),
        (WrenchStamped(), "wrench.torque.x", "Nm", "TorqueX"),
        (Imu(), "linear_acceleration.x", "m/s^2", "AccelerationX"),
        (Imu(), "angular_velocity.y", "rad/s", "AngularVelocityY"),
        (BatteryState(), "voltage", "V", "Voltage"),
        (BatteryState(), "current", "A", "Current"),
        (joints("a", position=[0.0]), "a.position", "", "JointPosition"),
        (Point(), "x", "m", "PositionX"),
    ],
)
def test_units_are_those_of_rep_103(message: Any, label: str, unit: str, kind: str) -> None:
    (channel,) = (each for each in layout_of(message).channels if each.label == label)
    assert (channel.unit, channel.kind) == (unit, kind)


def test_joints_give_their_names_to_the_channels() -> None:
    message = joints("shoulder", "elbow", position=[1.0, 2.0], velocity=[3.0, 4.0])
    layout = layout_of(message)
    assert layout.labels == (
        "shoulder.position",
        "elbow.position",
        "shoulder.velocity",
        "elbow.velocity",
    )
    assert list(layout.read(message)) == [1.0, 2.0, 3.0, 4.0]


def test_a_sequence_that_becomes_empty_is_no_value() -> None:
    layout = layout_of(joints("a", "b", position=[1.0, 2.0], effort=[5.0, 6.0]))
    values = layout.read(joints("a", "b", position=[3.0, 4.0]))
    assert list(values[:2]) == [3.0, 4.0]
    assert all(map(math.isnan, values[2:]))


@pytest.mark.parametrize(
    "other",
    [
        joints("a", "b", "c", position=[1.0, 2.0, 3.0]),
        joints("b", "a", position=[1.0, 2.0]),
        joints("a", position=[1.0]),
        joints("a", "b", position=[1.0, 2.0], velocity=[1.0, 2.0]),
    ],
)
def test_other_joints_need_another_layout(other: Any) -> None:
    layout = layout_of(joints("a", "b", position=[1.0, 2.0]))
    with pytest.raises(LayoutChangedError):
        layout.read(other)


def test_names_that_are_not_one_each_are_no_labels() -> None:
    for names in (("a", "a"), ("a", ""), ("a",)):
        layout = layout_of(joints(*names, position=[1.0, 2.0]))
        assert layout.labels == ("position[0]", "position[1]")


def test_an_array_of_messages_opens_into_its_elements() -> None:
    message = PoseArray(poses=[Pose(position=Point(x=1.0)), Pose(position=Point(x=2.0))])
    layout = layout_of(message, "poses[1].position", "poses[0].position.x")
    assert layout.labels == (
        "poses[0].position.x",
        *(f"poses[1].position.{axis}" for axis in "xyz"),
    )
    assert list(layout.read(message)) == [1.0, 2.0, 0.0, 0.0]
    one = layout.read(PoseArray(poses=[Pose()]))
    assert (one[0], all(map(math.isnan, one[1:]))) == (0.0, True)
    with pytest.raises(LayoutChangedError):
        layout_of(message).read(PoseArray(poses=[Pose()]))
    assert all(map(math.isnan, layout.read(PoseArray())))


def test_times_are_seconds() -> None:
    point = JointTrajectoryPoint(
        positions=[0.5], time_from_start=Duration(sec=2, nanosec=500_000_000)
    )
    message = JointTrajectory(joint_names=["a"], points=[point])
    layout = layout_of(message)
    times = [each for each in layout.channels if each.label.endswith("time_from_start")]
    assert [each.unit for each in times] == ["s"]
    assert list(layout.read(message)) == [0.5, 2.5]


def test_names_label_messages_and_the_field_still_finds_them() -> None:
    joints = MultiDOFJointState(joint_names=["a", "b"], wrench=[Wrench(), Wrench()])
    layout = layout_of(joints, "wrench")
    assert layout.labels[:2] == ("a.wrench.force.x", "a.wrench.force.y")
    assert [each.path for each in layout.channels][6] == "wrench[1].force.x"
    assert len(layout.labels) == 12


def test_points_of_a_trajectory_are_no_joints() -> None:
    points = [JointTrajectoryPoint(positions=[0.5, 1.5])] * 2
    layout = layout_of(JointTrajectory(joint_names=["a", "b"], points=points), "points")
    assert layout.labels[0] == "points[0].positions[0]"


def test_truth_and_bytes_are_numbers() -> None:
    assert list(layout_of(Bool()).read(Bool(data=True))) == [1]
    status = DiagnosticStatus(level=DiagnosticStatus.ERROR)
    assert list(layout_of(status).read(status)) == [2]


def test_an_enumeration_keeps_its_numbers_and_tells_their_names() -> None:
    (channel,) = layout_of(BatteryState(), "power_supply_status").channels
    assert channel.values[BatteryState.POWER_SUPPLY_STATUS_CHARGING] == "CHARGING"


def test_groups_and_labels_can_be_wanted() -> None:
    message = joints("a", "b", position=[1.0, 2.0], velocity=[3.0, 4.0])
    assert layout_of(message, "velocity").labels == ("a.velocity", "b.velocity")
    assert layout_of(message, "b").labels == ("b.position", "b.velocity")
    assert layout_of(message, "position[0]").labels == ("a.position",)
    one = layout_of(message, "b.velocity")
    assert list(one.read(message)) == [4.0]
    # A sequence that is empty today is still one of the type.
    assert layout_of(message, "velocity", "effort").labels == ("a.velocity", "b.velocity")


def test_a_field_that_is_not_there_is_named_with_those_that_are() -> None:
    with pytest.raises(SpecError, match=r"'pose.x'.*pose.pose.position.x") as caught:
        layout_of(Odometry(), "pose.x")
    assert caught.value.reason is SpecReason.INVALID


def test_more_channels_than_a_stream_can_have_are_refused() -> None:
    with pytest.raises(SpecError, match="name the fields") as caught:
        layout_of(LaserScan(ranges=array("f", [0.0] * 5000)))
    assert caught.value.reason is SpecReason.TOO_LARGE


def test_an_integer_that_a_float_would_round_is_noticed() -> None:
    layout = layout_of(UInt64())
    assert layout.inexact(layout.read(UInt64(data=2**53))) == ""
    assert layout.inexact(layout.read(UInt64(data=2**53 + 1))) == "data"


@pytest.mark.parametrize("package", ["geometry_msgs", "nav_msgs", "sensor_msgs", "trajectory_msgs"])
def test_every_type_of_a_package_can_be_laid_out(package: str) -> None:
    module = import_module(f"{package}.msg")
    found: list[Any] = list(vars(module).values())
    kinds = [each for each in found if hasattr(each, "SLOT_TYPES")]
    assert kinds
    for kind in kinds:
        assert message_class(type_name(kind)) is kind
        message = kind()
        layout = Layout(fields_of(kind), message)
        assert len(layout.read(message)) == len(layout.labels)
        assert len(set(layout.labels)) == len(layout.labels)
        assert not any(each.startswith("header.") for each in layout.labels)
        assert list(all_fields(fields_of(kind)))


finite = st.floats(allow_nan=False, width=64)


@given(rows=st.lists(st.lists(finite, min_size=3, max_size=3), min_size=1, max_size=4))
def test_any_numbers_come_out_as_they_went_in(rows: list[list[float]]) -> None:
    names = ("position", "velocity", "effort")
    columns = {name: [row[place] for row in rows] for place, name in enumerate(names)}
    message = joints(*(f"j{number}" for number in range(len(rows))), **columns)
    message.header = Header(frame_id="base")
    layout = layout_of(message)
    assert list(layout.read(message)) == [value for name in names for value in columns[name]]
