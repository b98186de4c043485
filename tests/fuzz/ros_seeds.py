"""Parameters of ``ros_to_lsl`` and messages to begin with."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from rclpy.serialization import serialize_message

from lsl_to_ros.ros_to_lsl.fields import message_class
from tests.fuzz.streams import join_counted
from tests.fuzz.targets.ros_to_lsl import CLASSES

Pose = message_class("geometry_msgs/msg/Pose")
_PARAMETERS: dict[str, dict[str, Any]] = {
    "whole": {"topics": ["/joint_states"]},
    "groups": {
        "topics": ["/a", "b"],
        "/a.fields": ["position", "pose.pose", "status", "poses[1]", "points"],
        "/a.name": "arm",
        "b.as": "markers",
        "b.type": "std_msgs/msg/String",
        "b.rate": 2.5,
    },
    "by_arrival": {"all_small": True, "stamps": "arrival", "use_sim_time": True},
    "odd_nothing": {"topics": [""], "session_id": "a"},
    "odd_two_of_one_name": {"topics": ["/a/b", "/c"], "/c.name": "a-b"},
    "odd_not_among": {"topics": ["/a"], "/b.rate": 1},
    "odd_two_slashes": {"topics": ["/a//b"]},
    "odd_option": {"topics": ["/a"], "/a.rat": 1},
    "odd_name": {"topics": ["/a"], "/a.name": "a b"},
    "odd_kind": {"topics": ["/a"], "/a.fields": "position"},
    "odd_rate": {"topics": ["/a"], "/a.rate": -1.0},
    "odd_simulated": {"topics": ["/a"], "use_sim_time": True},
    "odd_topic": {"topics": ["/a//b c"]},
}


def asked_and_sent() -> Iterator[tuple[str, bytes]]:
    """Give parameters, each with messages of all types."""
    for name, parameters in _PARAMETERS.items():
        line = json.dumps(parameters).encode()
        if name.startswith("odd_"):
            yield name, line
            continue
        yield name, line + b"\n" + join_counted([_piece(kind()) for kind in CLASSES])
        yield f"{name}_filled", line + b"\n" + join_counted([_piece(each) for each in _filled()])
    for name, joints in (("alike", ["a", "a"]), ("odd_no_xml", ["a\x01", "b\ufffe"])):
        sent = _made("sensor_msgs/msg/JointState", name=joints, position=[1.0, 2.0])
        yield name, b"{}\n" + join_counted([_piece(sent)])


def _filled() -> Iterator[Any]:
    joints = {"name": ["a", "b"], "position": [1.0, 2.0]}
    yield _made("sensor_msgs/msg/JointState", **joints)
    yield _made("sensor_msgs/msg/JointState", **joints, effort=[3.0, 4.0])
    yield _made("sensor_msgs/msg/JointState", name=["a"], position=[float("nan")])
    yield _made("sensor_msgs/msg/JointState")
    yield _made("std_msgs/msg/String", data='he said "ja" \u00e4\u4e16')
    yield _made("std_msgs/msg/UInt64", data=2**64 - 1)
    yield _made("sensor_msgs/msg/BatteryState", power_supply_status=1, cell_voltage=[3.7, 3.8])
    yield _made("std_msgs/msg/ByteMultiArray", data=[b"\x00", b"\xff"])
    yield _made("geometry_msgs/msg/PoseArray", poses=[Pose(), Pose()])
    yield _made("geometry_msgs/msg/PoseArray", poses=[Pose()])
    point = _made("trajectory_msgs/msg/JointTrajectoryPoint", positions=[0.5, 1.5])
    yield _made("trajectory_msgs/msg/JointTrajectory", joint_names=["a", "b"], points=[point] * 2)
    status = _made(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=b"\x02",
        name="a",
        values=[_made("diagnostic_msgs/msg/KeyValue", key="k", value="v")],
    )
    yield status
    yield _made("diagnostic_msgs/msg/DiagnosticArray", status=[status, status])


def _made(kind: str, /, **fields: Any) -> Any:
    return message_class(kind)(**fields)


def _piece(message: Any) -> bytes:
    return bytes([CLASSES.index(type(message))]) + serialize_message(message)
