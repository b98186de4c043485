"""Bytes on the wire are what ROS itself would have made of the message, for every value."""

from __future__ import annotations

import math
from array import array
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import MultiArrayDimension, MultiArrayLayout

from biosensor_common.quantities import MessageType
from biosensor_common.ros import numbers
from lsl_to_ros.topics.outputs import CLASSES


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
    encoded = numbers.RawNumbers(pair.message, channels).encode(samples)
    assert len(encoded) == len(samples)
    for message, sample in zip(encoded, samples.tolist(), strict=True):
        assert_same(message, pair.message, typed(pair.message, sample, channels=channels))


@pairs
def test_extremes(pair: Pair) -> None:
    samples = np.array(extremes(pair), pair.samples)[:, np.newaxis]
    encoded = numbers.RawNumbers(pair.message, 1).encode(samples)
    for message, sample in zip(encoded, samples.tolist(), strict=True):
        assert_same(message, pair.message, typed(pair.message, sample, channels=1))


@pairs
def test_many_at_once_are_what_each_is_alone(pair: Pair) -> None:
    channels = 3 if pair.message.is_array else 1
    samples = np.resize(np.array(extremes(pair), pair.samples), (300, channels))
    encode = numbers.RawNumbers(pair.message, channels).encode
    singly = [message for at in range(300) for message in encode(samples[at : at + 1])]
    assert encode(samples) == singly


@pytest.mark.parametrize("kind", [MessageType.FLOAT32, MessageType.FLOAT32_MULTI_ARRAY])
def test_a_float_too_large_for_its_message_is_infinite(kind: MessageType) -> None:
    samples = np.array([[1e300], [-1e300], [0.1]])
    encoded = numbers.RawNumbers(kind, 1).encode(samples)
    for message, value in zip(encoded, [math.inf, -math.inf, 0.1], strict=True):
        assert_same(message, kind, typed(kind, [value], channels=1))


@pytest.mark.parametrize("kind", sorted(NUMBERS))
def test_samples_that_lie_apart_in_memory_are_no_different(kind: MessageType) -> None:
    channels = 3 if kind.is_array else 1
    every_second = np.arange(48, dtype=np.int32).reshape(-1, 6)[::2, ::2][:, :channels]
    transposed = np.arange(12, dtype=np.int32).reshape(channels, -1).T
    for samples in (every_second, transposed):
        assert not samples.flags.c_contiguous or channels == 1
        encoded = numbers.RawNumbers(kind, channels).encode(samples)
        for message, sample in zip(encoded, samples.tolist(), strict=True):
            assert_same(message, kind, typed(kind, sample, channels=channels))


@pytest.mark.parametrize("kind", sorted(TYPECODES))
@pytest.mark.parametrize("channels", [1, 3, 8])
def test_the_layout_of_chunks_of_every_length(kind: MessageType, channels: int) -> None:
    dtype = numbers.wire_dtype(kind)
    # Downwards and up again: more lengths than heads are kept.
    for length in [*range(1000, 0, -1), 1, 500, 1000]:
        values = np.arange(length * channels, dtype=dtype)
        encoded = numbers.chunk_message(kind, values.tobytes(), channels)
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
    values = data.draw(arrays.arrays(numbers.wire_dtype(kind), length * channels))
    encoded = numbers.chunk_message(kind, values.tobytes(), channels)
    assert_same(encoded, kind, typed(kind, values.tolist(), samples=length, channels=channels))


def test_every_message_of_numbers_has_a_wire_type_and_no_other_has() -> None:
    for kind in MessageType:
        if kind.is_text:
            with pytest.raises(KeyError):
                numbers.wire_dtype(kind)
        else:
            assert kind in NUMBERS
            assert numbers.wire_dtype(kind).kind in "fiu"
