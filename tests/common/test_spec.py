from dataclasses import FrozenInstanceError, replace
from typing import Any

import pytest

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
    NominalScale,
    SensorSpec,
    StreamSpec,
    is_data_name,
)
from biosensor_common.table import channels, hardware, raw

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
    with pytest.raises(SpecError, match="'value': what has the role contact is in boolean, not"):
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
