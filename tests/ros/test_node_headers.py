"""Streams that lie, and announcements that cannot be used, harm nobody."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import pylsl
import pytest
from std_msgs.msg import Float32, Float32MultiArray, Int64MultiArray, String

from biosensor_common import naming
from biosensor_common.lsl_header import MAX_XML_CHARACTERS, describe
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]

Tamper = Callable[[ET.Element], None]


def set_field(name: str, text: str) -> Tamper:
    def tamper(desc: ET.Element) -> None:
        field = desc.find(f"biosensor/{name}")
        assert field is not None
        field.text = text

    return tamper


def drop_field(desc: ET.Element) -> None:
    block, field = desc.find("biosensor"), desc.find("biosensor/category")
    assert block is not None
    assert field is not None
    block.remove(field)


def repeat_block(desc: ET.Element) -> None:
    desc.extend(desc.findall("biosensor"))


def pad(desc: ET.Element) -> None:
    ET.SubElement(desc, "padding").text = "x" * MAX_XML_CHARACTERS


def break_xml(desc: ET.Element) -> None:
    ET.SubElement(desc, "note").text = "\x01"


LIES: list[tuple[str, Tamper, str]] = [
    ("version", set_field("version", "2"), "version '2'"),
    ("no_field", drop_field, "category"),
    ("two_blocks", repeat_block, "more than one"),
    ("unknown_message", set_field("message_type", "evil_msgs/msg/Bomb"), "evil_msgs/msg/Bomb"),
    ("text_message", set_field("message_type", "std_msgs/msg/String"), "std_msgs/msg/String"),
    (
        "whole_numbers",
        set_field("message_type", "std_msgs/msg/Int32MultiArray"),
        "std_msgs/msg/Int32MultiArray",
    ),
    ("other_source", set_field("unit", "somebody else"), "another source_id"),
    ("other_sensor", set_field("sensor", "polar_h10"), "another source_id"),
    ("bad_data_name", set_field("data_name", "../../x"), "lower-case ROS names"),
    ("bad_chunk", set_field("chunk", "a/b"), "lower-case ROS names"),
    ("undecided", set_field("is_state", "perhaps"), "instead of 'true' or 'false'"),
    ("regular_state", set_field("is_state", "true"), "to be a state"),
    ("long_field", set_field("unit", "u" * 129), "longer than"),
    ("huge", pad, "characters, more than"),
    ("not_xml", break_xml, "not well-formed"),
]


def append(parent: pylsl.XMLElement, element: ET.Element) -> None:
    for child in element:
        if len(child):
            append(parent.append_child(child.tag), child)
        else:
            parent.append_child_value(child.tag, child.text or "")


def lying(
    name: str,
    tamper: Tamper,
    sensor_name: str = "zephyr",
    channels: int = 1,
    format_: str = "float32",
) -> pylsl.StreamOutlet:
    """Open an outlet with a description that would be right but for *tamper* and its shape."""
    stream = declaration("zephyr").stream("ecg")
    identity = DeviceIdentity(sensor_name, name)
    source_id = naming.source_id(identity, "ecg")
    info = pylsl.StreamInfo(name, "ECG", channels, 250.0, format_, source_id)
    desc = describe(stream, identity, DeviceInfo())
    tamper(desc)
    append(info.desc(), desc)
    return pylsl.StreamOutlet(info)


def leave_alone(_: ET.Element) -> None:
    pass


def test_a_lying_description_makes_a_foreign_stream_and_one_sentence(
    ros: Ros, node: RunningNode
) -> None:
    # Topics of a node that a test before has killed stay until DDS misses it.
    ros.until(lambda: not _topics_of_claimed_sensor(ros), "topics of earlier tests to be gone")
    good = Outlet(
        declaration("polar_h10").stream("ecg"),
        DeviceIdentity("polar_h10", "H1", participant="good"),
        DeviceInfo(),
    )
    good_topic = "/good/biosensors/polar_h10/ecg"
    good_heard = ros.listen(Float32, good_topic)
    ros.attached(good_topic, readers=1)
    outlets = {name: lying(name, tamper) for name, tamper, _ in LIES}
    outlets["traversal"] = lying("traversal", leave_alone, sensor_name="../../x")
    heard = {name: ros.listen(Float32MultiArray, f"/biosensors/{name}/ECG") for name in outlets}
    ros.attached(*(f"/biosensors/{name}/ECG" for name in outlets), readers=1)
    for outlet in outlets.values():
        outlet.push_sample([1.5], pylsl.local_clock())
    assert good.push([2.5], [pylsl.local_clock()]) is None
    ros.until(lambda: bool(all(heard.values()) and good_heard), "a sample of each stream")
    assert [message.data for message in good_heard] == [2.5]
    for name, _, reason in [*LIES, ("traversal", leave_alone, "lower-case ROS names")]:
        assert list(heard[name][0].data) == [1.5]
        assert node.count("[WARN]", f"'{name}'") == 1
        assert node.count("[WARN]", f"'{name}'", reason) == 1
    assert not _topics_of_claimed_sensor(ros)


def _topics_of_claimed_sensor(ros: Ros) -> list[str]:
    return [topic for topic in ros.topics() if topic.startswith("/biosensors/zephyr")]


def claim_channels(desc: ET.Element) -> None:
    channels = desc.find("channels")
    assert channels is not None
    channels.extend([channels[0]] * 4)


def test_a_description_of_another_shape_is_refused_alone(ros: Ros, node: RunningNode) -> None:
    truthful = lying("shape_true", leave_alone, sensor_name="shape_sensor")
    good = ros.listen(Float32, "/biosensors/shape_sensor/ecg")
    integers = set_field("message_type", "std_msgs/msg/Int32MultiArray")
    cases: list[tuple[str, pylsl.StreamOutlet, type[Any], list[Any]]] = [
        # One value a message, but three a sample.
        ("shape_wide", lying("shape_wide", leave_alone, channels=3), Float32MultiArray, [1, 2, 3]),
        ("shape_text", lying("shape_text", leave_alone, format_="string"), String, ["text"]),
        ("shape_long", lying("shape_long", integers, format_="int64"), Int64MultiArray, [2**40]),
    ]
    topics = [f"/biosensors/{name}/ECG" for name, _, _, _ in cases]
    heard = [ros.listen(kind, topic) for (_, _, kind, _), topic in zip(cases, topics, strict=True)]
    # Five labels for one channel: none of them can be believed, but the rest can.
    labels = lying("shape_labels", claim_channels, sensor_name="shape_labels")
    labelled = ros.listen(Float32, "/biosensors/shape_labels/ecg")
    own = ["/biosensors/shape_sensor/ecg", "/biosensors/shape_labels/ecg"]
    ros.attached(*topics, *own, readers=1)
    for name, outlet, _, sample in cases:
        outlet.push_sample(sample, pylsl.local_clock())
        assert node.count("[WARN]", f"'{name}'", "does not fit the stream") == 1
    for outlet in (truthful, labels):
        outlet.push_sample([7.5], pylsl.local_clock())
    ros.until(lambda: all(heard) and bool(good and labelled), "a sample of each")
    for (_, _, kind, sample), messages in zip(cases, heard, strict=True):
        data = messages[0].data
        assert ([data] if kind is String else list(data)) == sample
    assert [message.data for message in (*good, *labelled)] == [7.5, 7.5]
    for topic in own:
        status = ros.status(topic)
        assert status is not None
        assert status["unit_of_measurement"] == ("counts" if topic == own[0] else "")


def set_unknown(desc: ET.Element) -> None:
    """Use a unit of one's own, and a role of a later version."""
    channel, unit = desc.find("channels/channel"), desc.find("channels/channel/unit")
    assert channel is not None
    assert unit is not None
    unit.text = "mmHg"
    ET.SubElement(channel, "role").text = "blood_pressure"


def test_a_truthful_description_is_taken_at_its_word(ros: Ros, node: RunningNode) -> None:
    # A sensor that neither this node nor the gateway has ever heard of.
    outlet = lying("truth", set_unknown, sensor_name="never_heard_of")
    topic = "/biosensors/never_heard_of/ecg"
    heard = ros.listen(Float32, topic)
    ros.attached(topic, readers=1)
    outlet.push_sample([1.5], pylsl.local_clock())
    ros.until(lambda: bool(heard), "a sample")
    assert heard[0].data == 1.5
    assert node.count("[WARN]", "truth") == 0
    status = ros.status(topic)
    assert status is not None
    assert status["unit_of_measurement"] == "mmHg"


def test_a_description_of_just_the_permitted_size_is_read(ros: Ros) -> None:
    def pad_less(desc: ET.Element) -> None:
        ET.SubElement(desc, "padding").text = "x" * (MAX_XML_CHARACTERS - 10_000)

    outlet = lying("large", pad_less, sensor_name="large_sensor")
    ros.attached("/biosensors/large_sensor/ecg")
    del outlet


def test_an_announcement_that_cannot_be_used_is_ignored(ros: Ros, node: RunningNode) -> None:
    outlets = [
        pylsl.StreamOutlet(pylsl.StreamInfo("no_channels", "EEG", 0, 0.0, "float32", "zero")),
        pylsl.StreamOutlet(pylsl.StreamInfo("nan_rate", "EEG", 1, math.nan, "float32", "nan")),
        pylsl.StreamOutlet(pylsl.StreamInfo("inf_rate", "EEG", 1, math.inf, "float32", "inf")),
        pylsl.StreamOutlet(pylsl.StreamInfo("huge_rate", "EEG", 1, 1e300, "float32", "huge")),
    ]
    fast = pylsl.StreamOutlet(pylsl.StreamInfo("fast", "EEG", 1, 1e6, "float32", "fast"))
    for sign in ("no_channels", "huge_rate", "(invalid"):
        ros.until(lambda sign=sign: node.count("[WARN]", "ignored", sign) > 0, f"warning: {sign}")
    heard = ros.listen(Float32MultiArray, "/biosensors/fast/EEG")
    ros.attached("/biosensors/fast/EEG", readers=1)
    for number in range(3):
        fast.push_sample([float(number)], pylsl.local_clock())
    ros.until(lambda: len(heard) >= 3, "samples of a very fast stream")
    assert [message.data[0] for message in heard] == [0.0, 1.0, 2.0]
    assert node.count("no_channels") == 1
    assert node.count("huge_rate") == 1
    assert not [topic for topic in ros.topics() if "no_channels" in topic]
    del outlets


def test_a_stream_that_claims_to_be_counters_but_is_not_harms_nobody(
    ros: Ros, node: RunningNode
) -> None:
    stream = replace(declaration("gateway").stream("counters"), rate=0.0)
    false = Outlet(stream, DeviceIdentity("gateway", "false"), DeviceInfo())
    ros.attached("/biosensors/gateway/counters")
    for text in ("nonsense", "[" * 50_000, '{"a":{"pushed":1e999,"lost":0,"last_stamp":0}}'):
        false.push_text(text, pylsl.local_clock())
    good = pylsl.StreamOutlet(pylsl.StreamInfo("after", "Markers", 1, 0.0, "string", "after"))
    heard = ros.listen(String, "/biosensors/after/Markers")
    ros.attached("/biosensors/after/Markers", readers=1)
    good.push_sample(["still here"], pylsl.local_clock())
    ros.until(lambda: bool(heard), "a marker")
    ros.report()
    status = ros.status("/biosensors/gateway/counters")
    assert status is not None
    assert status["received"] == "3"
    assert node.count("reading it failed") == 0
