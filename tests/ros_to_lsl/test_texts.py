"""Markers of messages."""

from __future__ import annotations

import json
import math
from array import array

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import SpecError
from lsl_to_ros.ros_to_lsl.fields import fields_of, message_class
from lsl_to_ros.ros_to_lsl.senders import as_json, has_records, is_text, marker_of, text_of

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
