"""Declarations of sensors: what they may say, and what they say."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from importlib import import_module
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest

from biosensor_common import naming
from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.quantities import (
    Category,
    ChannelFormat,
    ChannelRole,
    ContentType,
    MessageType,
    Unit,
)
from biosensor_common.spec import (
    FROM_DEVICE,
    IRREGULAR,
    ChannelSpec,
    DeviceIdentity,
    NominalScale,
    SensorSpec,
    StreamSpec,
    is_data_name,
)
from biosensor_common.table import channels, hardware, raw
from biosensor_gateway.devices.registry import declaration, declaration_names

ECG = StreamSpec(
    data_name="ecg",
    category=Category.RAW,
    content_type=ContentType.ECG,
    channels=(ChannelSpec("ECG", Unit.MICROVOLTS),),
    rate=130,
    format=ChannelFormat.FLOAT32,
    message_type=MessageType.FLOAT32,
    chunk="ecg",
)
EVENTS = StreamSpec(
    data_name="events",
    category=Category.HARDWARE,
    content_type=ContentType.MARKERS,
    channels=(ChannelSpec("event", Unit.NONE),),
    rate=IRREGULAR,
    format=ChannelFormat.STRING,
    message_type=MessageType.STRING,
)


def refused(stream: StreamSpec, **changes: Any) -> str:
    with pytest.raises(SpecError) as caught:
        replace(stream, **changes)
    assert caught.value.reason is SpecReason.INVALID
    return str(caught.value)


@pytest.mark.parametrize(
    "name",
    ["", "ECG", "1ecg", "_ecg", "ecg_", "e__cg", "e cg", "e/cg", "écg", "ecg_chunk", "ecg_stamped"],
)
def test_a_data_name_that_ros_or_another_topic_would_mind_is_refused(name: str) -> None:
    assert not is_data_name(name)
    assert "not a lower-case ROS name" in refused(ECG, data_name=name)


@pytest.mark.parametrize("name", ["ecg", "e", "eeg_status", "spo2", "chunk", "a_1"])
def test_an_ordinary_data_name_is_accepted(name: str) -> None:
    assert replace(ECG, data_name=name).data_name == name


def test_a_stream_without_channels_is_refused() -> None:
    assert "no channel" in refused(ECG, channels=())


@pytest.mark.parametrize("labels", [("X", "X"), ("X", ""), ("",)])
def test_empty_or_repeated_labels_are_refused(labels: tuple[str, ...]) -> None:
    changes = {"channels": channels(Unit.G, *labels)}
    message = refused(ECG, **changes, message_type=MessageType.FLOAT32_MULTI_ARRAY)
    assert "empty or repeated" in message


@pytest.mark.parametrize("unit", ["mmHg", "m/s^2", "l/min", "%", "1/64 g", "x" * 32])
def test_another_package_may_measure_in_a_unit_of_its_own(unit: str) -> None:
    (channel,) = channels(unit, "value")
    assert channel.unit == unit
    (scaled,) = channels(Unit.COUNTS, "value")
    assert replace(scaled, scale=NominalScale(0.5, unit)).scale is not None


@pytest.mark.parametrize(
    "unit",
    [
        "",
        " ",
        " g",
        "g ",
        "m  s",
        "\u00b5S",
        "a<b",
        "a>b",
        "a&b",
        '"',
        "'",
        "g\n",
        "g\x00",
        "x" * 33,
    ],
)
def test_a_unit_that_a_reader_would_stumble_over_is_refused(unit: str) -> None:
    for make in (
        lambda: channels(unit, "value"),
        lambda: ChannelSpec("value", Unit.COUNTS, NominalScale(0.5, unit)),
    ):
        with pytest.raises(SpecError) as caught:
            make()
        assert caught.value.reason is SpecReason.INVALID
        assert "'value': its unit" in str(caught.value)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 250


def test_what_has_a_role_is_in_its_unit_and_the_only_one() -> None:
    for role in ChannelRole:
        assert channels(role.unit, "value", roles=[role])[0].role is role
    with pytest.raises(SpecError, match="'value': the role contact requires the unit boolean, not"):
        channels(Unit.PERCENT, "value", roles=[ChannelRole.CONTACT])
    twice = channels(Unit.BOOLEAN, "a", "b", roles=[ChannelRole.CONTACT] * 2)
    assert "same role" in refused(ECG, channels=twice, message_type=MessageType.FLOAT32_MULTI_ARRAY)


@pytest.mark.parametrize("rate", [130, FROM_DEVICE])
def test_a_stream_with_a_rate_is_no_state(rate: Any) -> None:
    assert "a state has no rate" in refused(ECG, rate=rate, is_state=True)
    assert replace(EVENTS, is_state=True).is_state


def test_labels_beyond_ascii_are_refused() -> None:
    assert "ASCII" in refused(ECG, channels=channels(Unit.MICROVOLTS, "µV"))


@pytest.mark.parametrize("rate", [-1, float("inf"), float("-inf"), float("nan")])
def test_an_impossible_rate_is_refused(rate: float) -> None:
    assert "rate" in refused(ECG, rate=rate)


def test_int64_is_refused() -> None:
    assert "int64" in refused(
        ECG, format=ChannelFormat.INT64, message_type=MessageType.INT64_MULTI_ARRAY
    )


def test_text_needs_a_text_message() -> None:
    assert "do not fit" in refused(EVENTS, message_type=MessageType.FLOAT32)


def test_numbers_need_a_number_message() -> None:
    assert "do not fit" in refused(ECG, message_type=MessageType.STRING)


def test_several_channels_need_an_array() -> None:
    assert "one channel" in refused(ECG, channels=channels(Unit.G, *"XYZ"))


@pytest.mark.parametrize("chunk", ["ECG", "ecg_chunk", "e cg"])
def test_a_chunk_name_that_is_no_data_name_is_refused(chunk: str) -> None:
    assert "chunk name" in refused(ECG, chunk=chunk)


def test_text_has_no_chunks() -> None:
    assert "text has no chunks" in refused(EVENTS, rate=1, chunk="events")


def test_an_irregular_stream_has_no_chunks() -> None:
    assert "irregular" in refused(ECG, rate=IRREGULAR)


def test_a_refusal_names_the_stream() -> None:
    assert "'ecg'" in refused(ECG, channels=())


def test_a_rate_from_the_device_is_regular_and_may_have_chunks() -> None:
    stream = replace(ECG, rate=FROM_DEVICE)
    assert stream.is_from_device
    assert stream.is_regular


def test_zero_is_the_irregular_rate() -> None:
    assert not EVENTS.is_regular
    assert not EVENTS.is_from_device


def test_labels_keep_the_channel_order() -> None:
    assert hardware("acc", ContentType.ACCELEROMETER, channels(Unit.G, *"ZXY")).labels == (
        "Z",
        "X",
        "Y",
    )


def test_a_row_picks_the_message_by_the_number_of_channels() -> None:
    one = raw("hr", ContentType.HR, channels(Unit.BEATS_PER_MINUTE, "HR"))
    three = raw("acc", ContentType.ACCELEROMETER, channels(Unit.G, *"XYZ"))
    assert one.message_type is MessageType.FLOAT32
    assert three.message_type is MessageType.FLOAT32_MULTI_ARRAY


def test_a_declaration_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        ECG.rate = 250  # pyright: ignore[reportAttributeAccessIssue] - that is what is tested


def sensor_of(*streams: StreamSpec, name: str = "strap") -> SensorSpec:
    return SensorSpec(name=name, title="Strap", manufacturer="", model="", streams=streams)


def sensor_refused(*streams: StreamSpec, name: str = "strap") -> str:
    with pytest.raises(SpecError) as caught:
        sensor_of(*streams, name=name)
    assert caught.value.reason is SpecReason.INVALID
    return str(caught.value)


def test_a_sensor_needs_a_ros_name() -> None:
    assert "'Strap 2'" in sensor_refused(ECG, name="Strap 2")


def test_two_streams_of_one_name_are_refused() -> None:
    assert "share a topic" in sensor_refused(ECG, replace(ECG, chunk=""))


def test_two_streams_with_one_chunk_topic_are_refused() -> None:
    assert "share a topic" in sensor_refused(ECG, replace(ECG, data_name="ecg_two"))


def test_a_stream_is_found_by_its_name() -> None:
    spec = sensor_of(ECG, EVENTS)
    assert spec.stream("events") is EVENTS
    with pytest.raises(KeyError):
        spec.stream("hr")


TESTS = Path(__file__).parents[1]
GOLDEN = (TESTS / "common/golden/streams.json", *sorted(TESTS.glob("*/streams.json")))
"""What the agent itself emits, and in the folder of its tests what each sensor does."""
SENSORS = [declaration(name) for name in declaration_names()]
STREAMS = [
    pytest.param(stream, id=f"{spec.name}/{stream.data_name}")
    for spec in SENSORS
    for stream in spec.streams
]
INTEGER_RANGES = {
    ChannelFormat.INT8: (-(2**7), 2**7 - 1),
    ChannelFormat.INT16: (-(2**15), 2**15 - 1),
    ChannelFormat.INT32: (-(2**31), 2**31 - 1),
}


def row(spec: SensorSpec, stream: StreamSpec) -> dict[str, Any]:
    return {
        "sensor": spec.name,
        "data_name": stream.data_name,
        "category": stream.category.value,
        "lsl_type": stream.content_type.value,
        "channels": [channel_row(channel) for channel in stream.channels],
        "rate": stream.rate.value if stream.rate is FROM_DEVICE else stream.rate,
        "format": stream.format.value,
        "message_type": stream.message_type.value,
        "chunk_topic": f"{stream.chunk}_chunk" if stream.chunk else None,
        "contract": stream.contract,
        **({"is_state": True} if stream.is_state else {}),
    }


def channel_row(channel: ChannelSpec) -> list[str]:
    role = [] if channel.role is None else [channel.role.value]
    return [channel.label, channel.unit, *role]


def golden_rows() -> list[dict[str, Any]]:
    return [row for path in GOLDEN for row in json.loads(path.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("spec", SENSORS, ids=lambda spec: spec.name)
def test_sensor_emits_what_the_golden_table_says(spec: SensorSpec) -> None:
    expected = [golden for golden in golden_rows() if golden["sensor"] == spec.name]
    assert [row(spec, stream) for stream in spec.streams] == expected


def test_golden_table_knows_the_same_sensors() -> None:
    assert {golden["sensor"] for golden in golden_rows()} == {spec.name for spec in SENSORS}


@pytest.mark.parametrize("spec", SENSORS, ids=lambda spec: spec.name)
def test_sensor_is_described_in_ascii(spec: SensorSpec) -> None:
    assert spec.title
    assert f"{spec.name}{spec.title}{spec.manufacturer}{spec.model}".isascii()


@pytest.mark.parametrize("stream", STREAMS)
def test_every_channel_has_a_label_and_numbers_have_a_unit(stream: StreamSpec) -> None:
    is_text = stream.format is ChannelFormat.STRING
    for channel in stream.channels:
        is_quaternion = stream.content_type is ContentType.MOCAP and channel.label.startswith("Q")
        assert channel.label.isascii()
        assert channel.label.isprintable()
        assert channel.label.strip()
        assert (channel.unit is Unit.NONE) == (is_text or is_quaternion)


@pytest.mark.parametrize("stream", STREAMS)
def test_our_own_units_are_of_the_closed_set(stream: StreamSpec) -> None:
    assert all(isinstance(channel.unit, Unit) for channel in stream.channels)


@pytest.mark.parametrize("stream", STREAMS)
def test_only_counts_have_a_nominal_scale(stream: StreamSpec) -> None:
    scaled = [channel for channel in stream.channels if channel.scale is not None]
    assert all(channel.unit is Unit.COUNTS for channel in scaled)


def test_zephyr_ecg_says_how_counts_become_millivolts() -> None:
    (channel,) = declaration("zephyr").stream("ecg").channels
    assert channel.scale is not None
    assert channel.scale.unit is Unit.MILLIVOLTS


@pytest.mark.parametrize("stream", STREAMS)
def test_a_regular_stream_of_numbers_can_say_no_value(stream: StreamSpec) -> None:
    if stream.is_regular and stream.format is not ChannelFormat.STRING:
        assert stream.format.is_float


@pytest.mark.parametrize("stream", STREAMS)
def test_an_integer_message_gets_integers_that_reach_over_its_range(stream: StreamSpec) -> None:
    wanted = stream.message_type.integer_range
    assert (wanted is not None) == (stream.format in INTEGER_RANGES)
    if wanted is not None:
        low, high = INTEGER_RANGES[stream.format]
        assert low <= wanted[0] < wanted[1] <= high


@pytest.mark.parametrize("stream", STREAMS)
def test_text_has_one_channel(stream: StreamSpec) -> None:
    if stream.format is ChannelFormat.STRING:
        assert len(stream.channels) == 1


@pytest.mark.parametrize("stream", STREAMS)
def test_chunks_are_of_regular_raw_numbers(stream: StreamSpec) -> None:
    if stream.chunk:
        assert stream.is_regular
        assert stream.category is Category.RAW
        assert stream.format is ChannelFormat.FLOAT32


@pytest.mark.parametrize("stream", STREAMS)
def test_quality_is_an_array_beside_the_contract(stream: StreamSpec) -> None:
    if stream.data_name == "quality":
        assert stream.category is Category.HARDWARE
        assert stream.content_type is ContentType.QUALITY
        assert stream.message_type is MessageType.FLOAT32_MULTI_ARRAY
        assert not stream.contract


@pytest.mark.parametrize("message_type", list(MessageType))
def test_message_type_exists_in_ros(message_type: MessageType) -> None:
    pytest.importorskip("rclpy")
    package, folder, name = message_type.split("/")
    assert hasattr(import_module(f"{package}.{folder}"), name)


def test_lsl_names_and_source_ids_are_unique() -> None:
    pairs = [
        (DeviceIdentity(s.name, "0001"), stream.data_name) for s in SENSORS for stream in s.streams
    ]
    for build in (naming.lsl_name, naming.source_id):
        assert len({build(identity, data_name) for identity, data_name in pairs}) == len(pairs)


def test_topics_are_unique_and_valid_in_ros(ros_accepts: Callable[[str], bool]) -> None:
    topics: list[str] = []
    for spec in SENSORS:
        identity = DeviceIdentity(spec.name, "0001")
        for stream in spec.streams:
            name = naming.topic(identity, stream.data_name)
            assert name == f"biosensors/{spec.name}/{stream.data_name}"
            topics += [name, f"{name}_stamped"]
            if stream.chunk:
                topics.append(f"{naming.topic(identity, stream.chunk)}_chunk")
    assert len(set(topics)) == len(topics)
    assert all(ros_accepts(name) for name in topics)


def test_no_sensor_is_named_like_another_one_with_a_label() -> None:
    for one, other in permutations(declaration_names(), 2):
        assert not other.startswith(f"{one}_")
