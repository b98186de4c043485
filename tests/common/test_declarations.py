import json
from collections.abc import Callable
from importlib import import_module
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest

from biosensor_common import naming
from biosensor_common.quantities import Category, ChannelFormat, ContentType, MessageType, Unit
from biosensor_common.spec import FROM_DEVICE, ChannelSpec, DeviceIdentity, SensorSpec, StreamSpec
from biosensor_gateway.devices.registry import declaration, declaration_names

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
