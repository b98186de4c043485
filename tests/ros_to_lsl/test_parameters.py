"""Parameters of ``ros_to_lsl``, and the markers that it makes of messages."""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rclpy.node import Node
from rclpy.parameter import Parameter

from biosensor_common.errors import ConfigError, ConfigReason, SpecError
from lsl_to_ros.ros_to_lsl.fields import fields_of, message_class
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
    ({"topics": ["/a b"]}, ConfigReason.WRONG_VALUE, "no name of a topic"),
    ({"topics": ["a.b"]}, ConfigReason.WRONG_VALUE, "no name of a topic"),
    ({"topics": ["/a//b"]}, ConfigReason.WRONG_VALUE, "no name of a topic"),
    ({"topics": ["/a/{ns}"]}, ConfigReason.WRONG_VALUE, "no name of a topic"),
    ({"topics": ["/" + "a" * 300]}, ConfigReason.WRONG_VALUE, "no name of a topic"),
    ({"topics": ["/a"], "topic": ["/b"]}, ConfigReason.UNKNOWN_KEY, "topic is not a parameter"),
    ({"topics": ["/a"], "/b.rate": 5.0}, ConfigReason.UNKNOWN_KEY, "/b is not among"),
    ({"topics": ["/a"], "a.rate": 5.0}, ConfigReason.UNKNOWN_KEY, "spelt alike"),
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
