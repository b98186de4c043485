"""Numbers of messages as channels."""

from __future__ import annotations

import math
from array import array
from importlib import import_module
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.ros.fields import all_fields
from biosensor_common.ros.layout import Layout, LayoutChangedError
from lsl_to_ros.ros_to_lsl.fields import fields_of, message_class, type_name

# Their own annotations are partial.
Duration = message_class("builtin_interfaces/msg/Duration")
DiagnosticStatus = message_class("diagnostic_msgs/msg/DiagnosticStatus")
Point = message_class("geometry_msgs/msg/Point")
Pose = message_class("geometry_msgs/msg/Pose")
PoseArray = message_class("geometry_msgs/msg/PoseArray")
TwistStamped = message_class("geometry_msgs/msg/TwistStamped")
WrenchStamped = message_class("geometry_msgs/msg/WrenchStamped")
Odometry = message_class("nav_msgs/msg/Odometry")
BatteryState = message_class("sensor_msgs/msg/BatteryState")
Imu = message_class("sensor_msgs/msg/Imu")
JointState = message_class("sensor_msgs/msg/JointState")
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
