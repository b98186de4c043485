"""Streams of other programs: in every format, and headers that lie."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np
import pylsl
import pytest
from std_msgs.msg import (
    Float32,
    Float32MultiArray,
    Float64MultiArray,
    Int32MultiArray,
    Int64MultiArray,
    String,
)

from biosensor_common import naming
from biosensor_common.lsl_header import MAX_XML_CHARACTERS, describe
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]

# Streams that lie, and announcements that cannot be used, harm nobody.

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


# Streams of other programs in every format, and streams that return in another shape.
RATE = 100.0
FORMATS: list[tuple[str, type[Any], list[float]]] = [
    ("float32", Float32MultiArray, [math.inf, -math.inf, 16777216.0, 1.401298464324817e-45]),
    ("double64", Float64MultiArray, [0.1, 1.7976931348623157e308, 5e-324, -math.inf]),
    ("int8", Int32MultiArray, [-128, 127, 0, 1]),
    ("int16", Int32MultiArray, [-32768, 32767, 0, 1]),
    ("int32", Int32MultiArray, [-(2**31), 2**31 - 1, 0, 16777217]),
    ("int64", Int64MultiArray, [-(2**63), 2**63 - 1, 2**53 + 1, 1]),
]
SAID = "was restarted as"
TEXTS = ["", "two\nlines", '"quoted"', "\N{SNOWMAN}" * 10_000]


def foreign(name: str, channels: int, rate: float, format_: str) -> pylsl.StreamOutlet:
    info = pylsl.StreamInfo(name, "EEG", channels, rate, format_, f"id of {name}")
    return pylsl.StreamOutlet(info)


def dimensions(message: Any) -> list[tuple[str, int, int]]:
    return [(one.label, one.size, one.stride) for one in message.layout.dim]


@pytest.mark.seam
def test_no_number_loses_precision_neither_raw_nor_in_chunks(ros: Ros) -> None:
    opened: list[tuple[pylsl.StreamOutlet, list[Any], list[Any]]] = []
    for format_, kind, _ in FORMATS:
        topic = f"/biosensors/plain_{format_}/EEG"
        assert ros.set(f"plain_{format_}.Chunk_Length", 2) == ""
        raw, chunks = ros.listen(kind, topic), ros.listen(kind, f"{topic}_chunk")
        opened.append((foreign(f"plain_{format_}", 4, RATE, format_), raw, chunks))
    ros.attached(*(f"/biosensors/plain_{format_}/EEG" for format_, _, _ in FORMATS), readers=2)
    for (outlet, raw, chunks), (format_, _, values) in zip(opened, FORMATS, strict=True):
        begun = pylsl.local_clock()
        for number, sample in enumerate((values, values[::-1])):
            outlet.push_sample(sample, begun + number / RATE)
        ros.until(
            lambda raw=raw, chunks=chunks: len(raw) == 2 and bool(chunks), f"samples of {format_}"
        )
        assert [list(message.data) for message in raw] == [values, values[::-1]]
        assert list(chunks[0].data) == [*values, *values[::-1]]
        assert dimensions(raw[0]) == [("channels", 4, 4)]
        assert dimensions(chunks[0]) == [("samples", 2, 8), ("channels", 4, 4)]


def test_no_value_keeps_its_place_raw_and_in_chunks(ros: Ros) -> None:
    identity = DeviceIdentity("polar_h10", "U1", participant="nan")
    declared = Outlet(declaration("polar_h10").stream("ecg"), identity, DeviceInfo())
    other = {name: foreign(f"nan_{name}", 2, RATE, name) for name in ("float32", "double64")}
    ecg = "/nan/biosensors/polar_h10/ecg"
    topics = {name: f"/biosensors/nan_{name}/EEG" for name in other}
    kinds = {"float32": Float32MultiArray, "double64": Float64MultiArray}
    assert ros.set("Chunk_Length", 4) == ""
    single = ros.listen(Float32, ecg)
    single_chunk = ros.listen(Float32MultiArray, f"{ecg}_chunk")
    raw = {name: ros.listen(kinds[name], topics[name]) for name in other}
    chunk = {name: ros.listen(kinds[name], f"{topics[name]}_chunk") for name in other}
    ros.attached(ecg, *topics.values(), readers=2)
    begun = pylsl.local_clock()
    values = [1.0, math.nan, math.nan, 4.0]
    assert declared.push(values, [begun + number / 130 for number in range(4)]) is None
    pairs = [[1.0, math.nan], [math.nan, 2.0], [math.nan, math.nan], [3.0, 4.0]]
    for outlet in other.values():
        outlet.push_chunk(np.array(pairs), [begun + number / RATE for number in range(4)])
    ros.until(lambda: len(single) == 4 and bool(single_chunk), "the declared stream")
    ros.until(lambda: all(len(raw[name]) == 4 and chunk[name] for name in other), "the others")
    np.testing.assert_array_equal([message.data for message in single], values)
    np.testing.assert_array_equal(list(single_chunk[0].data), values)
    for name in other:
        np.testing.assert_array_equal([list(message.data) for message in raw[name]], pairs)
        np.testing.assert_array_equal(list(chunk[name][0].data), np.ravel(pairs))
    assert ros.set("Chunk_Length", 128) == ""


@pytest.mark.seam
def test_text_arrives_as_it_was_and_several_channels_as_a_list(ros: Ros) -> None:
    one, several = foreign("one_text", 1, 0.0, "string"), foreign("texts", 4, RATE, "string")
    topics = ["/biosensors/one_text/EEG", "/biosensors/texts/EEG"]
    single, listed = (ros.listen(String, topic) for topic in topics)
    ros.attached(*topics, readers=1)
    for text in TEXTS:
        one.push_sample([text], pylsl.local_clock())
    several.push_sample(TEXTS, pylsl.local_clock())
    ros.until(lambda: len(single) == len(TEXTS) and bool(listed), "all texts")
    assert [message.data for message in single] == TEXTS
    assert json.loads(listed[0].data) == TEXTS
    assert not {f"{topic}_chunk" for topic in topics} & ros.topics().keys()


def test_irregular_streams_have_no_chunks_and_lose_nothing(ros: Ros) -> None:
    mouse = foreign("mouse", 2, 0.0, "float32")
    untyped = pylsl.StreamOutlet(pylsl.StreamInfo("untyped", "", 1, 0.0, "int8", "untyped"))
    topics = ["/biosensors/mouse/EEG", "/biosensors/untyped/data"]
    heard = ros.listen(Float32MultiArray, topics[0])
    ros.attached(topics[0], readers=1)
    ros.attached(topics[1])
    stamp = pylsl.local_clock() - 10.0
    moves = [[float(number), math.nan if number % 3 else 0.5] for number in range(300)]
    for number, move in enumerate(moves):
        # A minute of silence, and several samples of one moment, are no gap and no fault.
        mouse.push_sample(move, stamp + (number // 3) * 0.1)
    ros.until(lambda: len(heard) >= len(moves), "all samples")
    np.testing.assert_array_equal([list(message.data) for message in heard], moves)
    assert not {f"{topic}_chunk" for topic in topics} & ros.topics().keys()
    del untyped


Shape = tuple[int, float, str]
"""Channels, rate, format."""


class Changing:
    """A stream under one source_id that comes in one shape and returns in another."""

    def __init__(self, name: str, *shapes: Shape) -> None:
        self.name = name
        self.shapes = shapes
        self.topic = f"/biosensors/{name}/EEG"
        self._number = -1
        self._outlet: pylsl.StreamOutlet | None = None

    @property
    def kind(self) -> type[Any]:
        format_ = self.shapes[self._number][2]
        kinds = {name: kind for name, kind, _ in FORMATS}
        return String if format_ == "string" else kinds[format_]

    def come(self, number: int) -> None:
        """Open the outlet in one of the shapes, after the one before has gone."""
        self._outlet = None
        self._number = number
        self._outlet = foreign(self.name, *self.shapes[number])

    def sample(self) -> list[Any]:
        channels, _, format_ = self.shapes[self._number]
        return ["text" if format_ == "string" else channels] * channels

    def push(self) -> None:
        assert self._outlet is not None
        self._outlet.push_sample(self.sample(), pylsl.local_clock())


def nominal_rates(ros: Ros, topics: Iterable[str]) -> dict[str, str]:
    """Rates as the latest report has them, of the streams that it has."""
    found = ((topic, ros.status(topic)) for topic in topics)
    return {topic: status["rate_nominal"] for topic, status in found if status is not None}


def test_another_rate_or_channel_count_is_published_as_it_is_and_said_once(
    ros: Ros, node: RunningNode
) -> None:
    streams = [
        Changing("other_rate", (2, 100.0, "float32"), (2, 50.0, "float32")),
        Changing("wider", (2, 100.0, "float32"), (5, 100.0, "float32")),
        Changing("narrower", (4, 100.0, "float32"), (1, 100.0, "float32")),
        Changing("irregular", (3, 100.0, "float32"), (3, 0.0, "float32")),
        Changing("unchanged", (3, 100.0, "float32"), (3, 100.0, "float32")),
    ]
    assert ros.set("Chunk_Length", 3) == ""
    raw = [ros.listen(Float32MultiArray, stream.topic) for stream in streams]
    chunks = [ros.listen(Float32MultiArray, f"{stream.topic}_chunk") for stream in streams]
    for number in range(2):
        for stream in streams:
            stream.come(number)
        rates = {stream.topic: f"{stream.shapes[number][1]:.2f}" for stream in streams}
        ros.until(lambda rates=rates: nominal_rates(ros, rates) == rates, "all in the new shape")
        for messages in raw:
            messages.clear()

        def all_flow(number: int = number) -> bool:
            for stream in streams:
                stream.push()
            return all(
                len([one for one in messages if list(one.data) == stream.sample()]) >= 7
                for stream, messages in zip(streams, raw, strict=True)
            )

        ros.until(all_flow, "samples in the new shape")
    for stream, messages, chunk in zip(streams, raw, chunks, strict=True):
        for message in [*messages, *chunk]:
            width = int(message.data[0])
            assert set(message.data) == {float(width)}
            assert dimensions(message)[-1] == ("channels", width, width)
            assert len(message.data) in {width, 3 * width}
        seen = {int(message.data[0]) for message in chunk}
        rates = {shape[1] for shape in stream.shapes}
        assert seen == ({shape[0] for shape in stream.shapes} if 0.0 not in rates else {3})
        has_changed = stream.shapes[0] != stream.shapes[1]
        assert node.count("[WARN]", f"{stream.name}/EEG", SAID) == has_changed
    channels, rate = "5 channels", "at 50.0"
    assert node.count("[WARN]", "wider/EEG", channels) == 1
    assert node.count("[WARN]", "other_rate/EEG", rate) == 1
    assert ros.set("Chunk_Length", 128) == ""


def test_another_format_changes_the_type_of_the_topic_and_is_said_once(
    ros: Ros, node: RunningNode
) -> None:
    streams = [
        Changing("wide", (2, 100.0, "float32"), (2, 100.0, "double64")),
        Changing("whole", (2, 100.0, "double64"), (3, 100.0, "int32")),
        Changing("small", (2, 100.0, "int8"), (2, 100.0, "int16")),
        Changing("words", (1, 0.0, "string"), (1, 100.0, "float32")),
        Changing("silent", (2, 100.0, "float32"), (1, 0.0, "string")),
    ]
    types = ["Float64MultiArray", "Int32MultiArray", "Int32MultiArray", "Float32MultiArray"]
    for number in range(2):
        for stream in streams:
            stream.come(number)
        # A process, too, cannot have two types of one topic.
        heard = [ros.listen(stream.kind, stream.topic) for stream in streams]

        def all_flow(heard: list[list[Any]] = heard) -> bool:
            for stream in streams:
                stream.push()
            return all(heard)

        ros.until(all_flow, "samples in each format")
        for stream, messages in zip(streams, heard, strict=True):
            expected = stream.sample()
            for message in messages:
                got = [message.data] if stream.kind is String else list(message.data)
                assert got == expected
        ros.stop_listening()
    for stream, name in zip(streams, [*types, "String"], strict=True):
        only = [f"std_msgs/msg/{name}"]
        ros.until(
            lambda stream=stream, only=only: ros.topics().get(stream.topic) == only,
            f"{stream.topic} as {name}",
        )
        if name != "String":
            assert ros.topics()[f"{stream.topic}_chunk"] == only
        assert node.count("[WARN]", f"{stream.name}/EEG", SAID) == 1


def test_streams_that_claim_one_topic_in_several_types_do_no_harm(
    ros: Ros, node: RunningNode
) -> None:
    claims: list[Any] = [
        pylsl.StreamOutlet(pylsl.StreamInfo("claimed", "EEG", 1, 0.0, format_, ""))
        for format_ in ("float32", "int32", "string")
    ]
    # What is derived from one stream, another one of the same device may have as its name.
    wristband = DeviceIdentity("empatica_e4", "U1", participant="claims")
    skin = declaration("empatica_e4").stream("st")
    claims += [
        Outlet(replace(skin, data_name=data, chunk="st"), wristband, DeviceInfo())
        for data in ("st", "st_temperature")
    ]
    good = foreign("unclaimed", 1, 0.0, "float32")
    heard = ros.listen(Float32MultiArray, "/biosensors/unclaimed/EEG")
    wanted = {"/biosensors/claimed/EEG", "/claims/biosensors/empatica_e4/st"}
    ros.until(lambda: wanted <= ros.present(), "the first of each")
    ros.attached("/biosensors/unclaimed/EEG", readers=1)
    ros.report()
    good.push_sample([1.0], pylsl.local_clock())
    ros.until(lambda: bool(heard), "a sample of another stream")
    assert node.is_running
    del claims


def test_a_known_programs_stream_has_the_name_of_its_sensor(ros: Ros) -> None:
    info = pylsl.StreamInfo("lab phone_Neon Gaze", "Gaze", 2, 200.0, "float32", "of the phone")
    topic = "/biosensors/pupil_neon/gaze"
    raw, outlet = ros.listen(Float32MultiArray, topic), pylsl.StreamOutlet(info)
    ros.attached(topic, readers=1)
    outlet.push_sample([800.5, 600.25])
    ros.until(lambda: bool(raw), "a gaze")
    assert list(raw[0].data) == [800.5, 600.25]
