"""Messages by their names, and their bytes on the wire as ROS would have made them."""

from __future__ import annotations

import json
import math
from array import array
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Empty, Header, MultiArrayDimension, MultiArrayLayout, String

from biosensor_common.device_clock import ClockState
from biosensor_common.quantities import MessageType, chunk_type
from biosensor_common.ros import messages
from biosensor_common.ros.messages import (
    clock_of,
    counters_message,
    raw_text,
    read_counters,
    text_of,
)
from biosensor_gateway.streaming.counters import Counters, counters_text
from lsl_to_ros.topics.outputs import CLASSES

# Bytes on the wire are what ROS itself would have made of the message, for every value.


class Pair(NamedTuple):
    """A stream's format and a message type that it can have."""

    samples: type[Any]
    message: MessageType
    limits: tuple[float, float] | None = None


# The largest finite float32 but one: checked messages refuse the largest itself.
MAX_FLOAT32 = float(np.nextafter(np.finfo(np.float32).max, np.float32(0)))
PAIRS = [
    Pair(np.float32, MessageType.FLOAT32, (-MAX_FLOAT32, MAX_FLOAT32)),
    Pair(np.int16, MessageType.FLOAT32),
    Pair(np.int16, MessageType.UINT8, (0, 255)),
    Pair(np.int32, MessageType.UINT8, (0, 255)),
    Pair(np.int8, MessageType.UINT8, (0, 127)),
    Pair(np.int16, MessageType.UINT16, (0, 32767)),
    Pair(np.int32, MessageType.UINT16, (0, 65535)),
    Pair(np.float32, MessageType.FLOAT32_MULTI_ARRAY),
    Pair(np.int8, MessageType.FLOAT32_MULTI_ARRAY),
    Pair(np.int16, MessageType.FLOAT32_MULTI_ARRAY),
    Pair(np.float32, MessageType.FLOAT64_MULTI_ARRAY),
    Pair(np.float64, MessageType.FLOAT64_MULTI_ARRAY),
    Pair(np.int32, MessageType.FLOAT64_MULTI_ARRAY),
    Pair(np.int8, MessageType.INT32_MULTI_ARRAY),
    Pair(np.int16, MessageType.INT32_MULTI_ARRAY),
    Pair(np.int32, MessageType.INT32_MULTI_ARRAY),
    Pair(np.int32, MessageType.INT64_MULTI_ARRAY),
    Pair(np.int64, MessageType.INT64_MULTI_ARRAY),
]
TYPECODES = {
    MessageType.FLOAT32_MULTI_ARRAY: "f",
    MessageType.FLOAT64_MULTI_ARRAY: "d",
    MessageType.INT32_MULTI_ARRAY: "i",
    MessageType.INT64_MULTI_ARRAY: "q",
}
NUMBERS = {pair.message for pair in PAIRS}
pairs = pytest.mark.parametrize(
    "pair", PAIRS, ids=lambda pair: f"{pair.samples.__name__}-{pair.message}"
)


def typed(kind: MessageType, values: list[Any], **sizes: int) -> Any:
    """Fill a message as any program would; *sizes* are the dimensions, outermost first."""
    message = CLASSES[kind]()
    if not kind.is_array:
        (value,) = values
        message.data = float(value) if kind is MessageType.FLOAT32 else value
        return message
    message.data = array(TYPECODES[kind], values)
    message.layout = MultiArrayLayout(
        dim=[
            MultiArrayDimension(
                label=label, size=size, stride=math.prod(list(sizes.values())[place:])
            )
            for place, (label, size) in enumerate(sizes.items())
        ]
    )
    return message


def assert_same(encoded: bytes, kind: MessageType, expected: Any) -> None:
    """Compare bit by bit, for NaN is not equal to itself."""
    serialised = serialize_message(expected)
    assert len(encoded) == len(serialised)
    assert encoded[:4] == serialised[:4]
    found, wanted = (deserialize_message(data, CLASSES[kind]) for data in (encoded, serialised))
    assert bits(found) == bits(wanted)


def bits(message: Any) -> tuple[object, ...]:
    if not hasattr(message, "layout"):
        return ("NaN" if math.isnan(message.data) else (message.data, str(message.data)),)
    dimensions = [(dim.label, dim.size, dim.stride) for dim in message.layout.dim]
    return dimensions, message.layout.data_offset, message.data.typecode, message.data.tobytes()


def elements(pair: Pair) -> st.SearchStrategy[Any]:
    dtype = np.dtype(pair.samples)
    if pair.limits is None:
        return arrays.from_dtype(dtype)
    low, high = pair.limits
    if dtype.kind == "i":
        return st.integers(int(low), int(high))
    return st.sampled_from([math.nan, math.inf, -math.inf]) | st.floats(low, high, width=32)


def extremes(pair: Pair) -> list[float]:
    """Return the values at the ends of a format, and around zero."""
    if np.dtype(pair.samples).kind == "i":
        info = np.iinfo(pair.samples)
        low, high = pair.limits or (info.min, info.max)
        return [low, high, *(value for value in (-1, 0, 1) if low <= value <= high)]
    smallest = float(np.finfo(pair.samples).smallest_subnormal)
    high = pair.limits[1] if pair.limits else float(np.finfo(pair.samples).max)
    return [math.nan, math.inf, -math.inf, high, -high, smallest, -smallest, 0.0, -0.0]


@pairs
@settings(deadline=None, max_examples=40)
@given(data=st.data())
def test_each_sample_is_the_message_that_ros_makes_of_it(pair: Pair, data: st.DataObject) -> None:
    channels = data.draw(st.integers(1, 40)) if pair.message.is_array else 1
    shape = (data.draw(st.integers(0, 12)), channels)
    samples: NDArray[Any] = data.draw(arrays.arrays(pair.samples, shape, elements=elements(pair)))
    encoded = messages.RawNumbers(pair.message, channels).encode(samples)
    assert len(encoded) == len(samples)
    for message, sample in zip(encoded, samples.tolist(), strict=True):
        assert_same(message, pair.message, typed(pair.message, sample, channels=channels))


@pairs
def test_extremes(pair: Pair) -> None:
    samples = np.array(extremes(pair), pair.samples)[:, np.newaxis]
    encoded = messages.RawNumbers(pair.message, 1).encode(samples)
    for message, sample in zip(encoded, samples.tolist(), strict=True):
        assert_same(message, pair.message, typed(pair.message, sample, channels=1))


@pairs
def test_many_at_once_are_what_each_is_alone(pair: Pair) -> None:
    channels = 3 if pair.message.is_array else 1
    samples = np.resize(np.array(extremes(pair), pair.samples), (300, channels))
    encode = messages.RawNumbers(pair.message, channels).encode
    singly = [message for at in range(300) for message in encode(samples[at : at + 1])]
    assert encode(samples) == singly


@pytest.mark.parametrize("kind", [MessageType.FLOAT32, MessageType.FLOAT32_MULTI_ARRAY])
def test_a_float_too_large_for_its_message_is_infinite(kind: MessageType) -> None:
    samples = np.array([[1e300], [-1e300], [0.1]])
    encoded = messages.RawNumbers(kind, 1).encode(samples)
    for message, value in zip(encoded, [math.inf, -math.inf, 0.1], strict=True):
        assert_same(message, kind, typed(kind, [value], channels=1))


@pytest.mark.parametrize("kind", sorted(NUMBERS))
def test_samples_that_lie_apart_in_memory_are_no_different(kind: MessageType) -> None:
    channels = 3 if kind.is_array else 1
    every_second = np.arange(48, dtype=np.int32).reshape(-1, 6)[::2, ::2][:, :channels]
    transposed = np.arange(12, dtype=np.int32).reshape(channels, -1).T
    for samples in (every_second, transposed):
        assert not samples.flags.c_contiguous or channels == 1
        encoded = messages.RawNumbers(kind, channels).encode(samples)
        for message, sample in zip(encoded, samples.tolist(), strict=True):
            assert_same(message, kind, typed(kind, sample, channels=channels))


@pytest.mark.parametrize("kind", sorted(TYPECODES))
@pytest.mark.parametrize("channels", [1, 3, 8])
def test_the_layout_of_chunks_of_every_length(kind: MessageType, channels: int) -> None:
    dtype = messages.wire_dtype(kind)
    # Downwards and up again: more lengths than heads are kept.
    for length in [*range(1000, 0, -1), 1, 500, 1000]:
        values = np.arange(length * channels, dtype=dtype)
        encoded = messages.chunk_message(kind, values.tobytes(), channels)
        message = deserialize_message(encoded, CLASSES[kind])
        assert [(dim.label, dim.size, dim.stride) for dim in message.layout.dim] == [
            ("samples", length, length * channels),
            ("channels", channels, channels),
        ]
        assert message.layout.data_offset == 0
        assert message.data.tobytes() == values.tobytes()


@settings(deadline=None, max_examples=60)
@given(
    kind=st.sampled_from(sorted(TYPECODES)),
    length=st.integers(1, 1000),
    channels=st.integers(1, 8),
    data=st.data(),
)
def test_a_chunk_is_the_message_that_ros_makes_of_it(
    kind: MessageType, length: int, channels: int, data: st.DataObject
) -> None:
    values = data.draw(arrays.arrays(messages.wire_dtype(kind), length * channels))
    encoded = messages.chunk_message(kind, values.tobytes(), channels)
    assert_same(encoded, kind, typed(kind, values.tolist(), samples=length, channels=channels))


def test_every_message_of_numbers_has_a_wire_type_and_no_other_has() -> None:
    for kind in MessageType:
        if kind.is_text:
            with pytest.raises(KeyError):
                messages.wire_dtype(kind)
        else:
            assert kind in NUMBERS
            assert messages.wire_dtype(kind).kind in "fiu"


# Messages by their names, and those of text.
# ROS ends a text at its first NUL, as rclpy's own objects do.
any_text = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))


@pytest.mark.parametrize("kind", MessageType)
def test_every_type_of_the_closed_set_has_its_class(kind: MessageType) -> None:
    package, _, name = kind.value.split("/")
    message_class = CLASSES[kind]
    assert message_class.__module__.startswith(f"{package}.msg.")
    assert message_class.__name__ == name


@pytest.mark.parametrize(
    ("raw", "chunk"),
    [
        (MessageType.FLOAT32, MessageType.FLOAT32_MULTI_ARRAY),
        (MessageType.UINT8, MessageType.FLOAT32_MULTI_ARRAY),
        (MessageType.UINT16, MessageType.FLOAT32_MULTI_ARRAY),
        (MessageType.FLOAT32_MULTI_ARRAY, MessageType.FLOAT32_MULTI_ARRAY),
        (MessageType.FLOAT64_MULTI_ARRAY, MessageType.FLOAT64_MULTI_ARRAY),
        (MessageType.INT32_MULTI_ARRAY, MessageType.INT32_MULTI_ARRAY),
        (MessageType.INT64_MULTI_ARRAY, MessageType.INT64_MULTI_ARRAY),
    ],
)
def test_a_chunk_keeps_the_precision_of_its_samples(raw: MessageType, chunk: MessageType) -> None:
    assert chunk_type(raw) is chunk


def samples(*texts: str) -> list[Any]:
    """Return one sample as a list and as what an inlet delivers."""
    return [list(texts), np.array(texts, object)]


def sent(kind: MessageType, sample: Any) -> Any:
    """Return what a subscriber gets of a sample of text."""
    message = raw_text(kind, text_of(sample))
    return deserialize_message(message, CLASSES[kind])


@given(text=any_text)
def test_a_single_text_goes_as_it_is(text: str) -> None:
    for sample in samples(text):
        assert sent(MessageType.STRING, sample) == String(data=text)


@given(texts=st.lists(any_text, min_size=2, max_size=5))
def test_several_texts_can_be_told_apart(texts: list[str]) -> None:
    for sample in samples(*texts):
        assert json.loads(sent(MessageType.STRING, sample).data) == texts


def test_an_event_without_text_only_says_that_it_came() -> None:
    assert sent(MessageType.EMPTY, ["pressed"]) == Empty()


def test_counters_become_a_diagnostic_array() -> None:
    counters = {
        "zephyr-1-ecg": Counters(pushed=250, lost=3, last_stamp=12.5),
        "a": Counters(pushed=1),
    }
    message = counters_message(17_250_000_000, counters_text(counters))
    statuses = [
        DiagnosticStatus(
            level=DiagnosticStatus.OK,
            name=name,
            values=[
                KeyValue(key="pushed", value=pushed),
                KeyValue(key="lost", value=lost),
                KeyValue(key="last_stamp", value=last),
            ],
        )
        for name, pushed, lost, last in (
            ("zephyr-1-ecg", "250.0", "3.0", "12.5"),
            ("a", "1.0", "0.0", "0.0"),
        )
    ]
    header = Header(stamp=Time(sec=17, nanosec=250_000_000))
    expected = DiagnosticArray(header=header, status=statuses)
    assert deserialize_message(message, DiagnosticArray) == expected


def test_what_the_agent_writes_is_read_again() -> None:
    written = {
        "zephyr-1-ecg": Counters(pushed=2**40, lost=3, last_stamp=123456.789012345),
        "zephyr-1-hr": Counters(),
    }
    read = read_counters(counters_text(written))
    assert read == {
        source_id: {"pushed": its.pushed, "lost": its.lost, "last_stamp": its.last_stamp}
        for source_id, its in written.items()
    }


def test_a_device_s_clock_comes_with_the_counters_of_one_of_its_streams() -> None:
    clock = ClockState(-1795230819.108032, 3.18, 0.000271, 1, 9)
    text = counters_text({"a": Counters(), "b": Counters()}, {"a": clock})
    read = read_counters(text)
    assert clock_of(read["a"]) == {
        "offset_s": -1795230819.108032,
        "drift_ppm": 3.18,
        "residual_rms_s": 0.000271,
        "reanchors": 1,
    }
    assert clock_of(read["b"]) == {}


@pytest.mark.parametrize("clock", ["null", "3", '{"offset_s": NaN}'])
def test_a_clock_that_no_agent_writes_is_a_value_error(clock: str) -> None:
    text = f'{{"a": {{"pushed": 1, "lost": 0, "last_stamp": 0, "clock": {clock}}}}}'
    with pytest.raises(ValueError, match=r".+"):
        read_counters(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "not JSON",
        "[]",
        "3",
        '{"a": 1}',
        '{"a": {}}',
        '{"a": {"pushed": null, "lost": 0, "last_stamp": 0}}',
        '{"a": {"pushed": "many", "lost": 0, "last_stamp": 0}}',
        '{"a": {"pushed": NaN, "lost": 0, "last_stamp": 0}}',
        '{"a": {"pushed": 1e999, "lost": 0, "last_stamp": 0}}',
        '{"a": {"pushed": 1' + "0" * 400 + ', "lost": 0, "last_stamp": 0}}',
        "[" * 100_000,
    ],
    ids=lambda text: text[:40] or "empty",
)
def test_what_no_agent_writes_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError, match=r".+"):
        read_counters(text)


@given(text=st.text())
def test_reading_counters_raises_nothing_else(text: str) -> None:
    with suppress(ValueError):
        read_counters(text)
