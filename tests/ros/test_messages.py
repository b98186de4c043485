"""Samples become messages of their declared type, unaltered or not at all."""

from __future__ import annotations

import json
import math
from array import array
from contextlib import suppress
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from std_msgs.msg import (
    Empty,
    Float32,
    Float32MultiArray,
    Float64MultiArray,
    Int32MultiArray,
    Int64MultiArray,
    String,
    UInt8,
    UInt16,
)

from biosensor_common.quantities import MessageType
from biosensor_gateway.outlets import Counters, counters_text
from lsl_to_ros import messages


def to_time(stamp: float) -> Time:
    return Time(sec=int(stamp), nanosec=round(stamp % 1 * 1e9))


def build(kind: MessageType, sample: list[Any], stamp: float = 0.0) -> Any:
    return messages.builder(kind, len(sample), to_time)(sample, stamp)


@pytest.mark.parametrize("kind", MessageType)
def test_every_type_of_the_closed_set_has_a_class_and_a_builder(kind: MessageType) -> None:
    package, _, name = kind.value.split("/")
    message_class = messages.CLASSES[kind]
    assert message_class.__module__.startswith(f"{package}.msg.")
    assert message_class.__name__ == name
    sample = ["{}"] if kind.is_text else [1]
    assert isinstance(build(kind, sample), message_class)


@pytest.mark.parametrize(
    ("kind", "message_class", "sample"),
    [
        (MessageType.FLOAT32_MULTI_ARRAY, Float32MultiArray, [0.5, -1.25, 3.0]),
        (MessageType.FLOAT64_MULTI_ARRAY, Float64MultiArray, [0.1, 1e300, -5e-324]),
        (MessageType.INT32_MULTI_ARRAY, Int32MultiArray, [2**31 - 1, -(2**31), 0]),
        (MessageType.INT64_MULTI_ARRAY, Int64MultiArray, [2**63 - 1, -(2**63), 0]),
    ],
)
def test_an_array_holds_a_sample_exactly(
    kind: MessageType, message_class: type[Any], sample: list[Any]
) -> None:
    message = build(kind, sample)
    assert isinstance(message, message_class)
    assert list(message.data) == sample
    (dimension,) = message.layout.dim
    assert (dimension.label, dimension.size, dimension.stride) == ("channels", 3, 3)


def test_scalars() -> None:
    assert build(MessageType.FLOAT32, [0.5]) == Float32(data=0.5)
    assert math.isnan(build(MessageType.FLOAT32, [math.nan]).data)
    assert build(MessageType.UINT8, [255]) == UInt8(data=255)
    assert build(MessageType.UINT16, [65535]) == UInt16(data=65535)
    assert build(MessageType.EMPTY, ["pressed"]) == Empty()


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (MessageType.UINT8, 256),
        (MessageType.UINT8, -1),
        (MessageType.UINT8, math.nan),
        (MessageType.UINT16, 65536),
        (MessageType.UINT16, -1),
    ],
)
def test_a_value_that_does_not_fit_is_refused(kind: MessageType, value: float) -> None:
    with pytest.raises(ValueError, match="does not fit"):
        build(kind, [value])


@given(text=st.text(st.characters(exclude_categories=["Cs"])))
def test_a_single_text_goes_as_it_is(text: str) -> None:
    assert build(MessageType.STRING, [text]) == String(data=text)


@given(texts=st.lists(st.text(), min_size=2, max_size=5))
def test_several_texts_can_be_told_apart(texts: list[str]) -> None:
    assert json.loads(build(MessageType.STRING, texts).data) == texts


@pytest.mark.parametrize(
    ("raw", "chunk"),
    [
        (MessageType.FLOAT32, MessageType.FLOAT32_MULTI_ARRAY),
        (MessageType.UINT8, MessageType.FLOAT32_MULTI_ARRAY),
        (MessageType.FLOAT32_MULTI_ARRAY, MessageType.FLOAT32_MULTI_ARRAY),
        (MessageType.FLOAT64_MULTI_ARRAY, MessageType.FLOAT64_MULTI_ARRAY),
        (MessageType.INT32_MULTI_ARRAY, MessageType.INT32_MULTI_ARRAY),
        (MessageType.INT64_MULTI_ARRAY, MessageType.INT64_MULTI_ARRAY),
    ],
)
def test_a_chunk_keeps_the_precision_of_its_samples(raw: MessageType, chunk: MessageType) -> None:
    assert messages.chunk_type(raw) is chunk


@given(samples=st.integers(1, 50), channels=st.integers(1, 6))
def test_the_layout_of_a_chunk(samples: int, channels: int) -> None:
    values = array("f", range(samples * channels))
    message = messages.chunk_message(MessageType.FLOAT32_MULTI_ARRAY, values, channels)
    assert [(dim.label, dim.size, dim.stride) for dim in message.layout.dim] == [
        ("samples", samples, samples * channels),
        ("channels", channels, channels),
    ]
    assert message.layout.data_offset == 0
    assert message.data == values


def test_counters_become_a_diagnostic_array() -> None:
    text = counters_text({"zephyr-1-ecg": Counters(pushed=250, lost=3, last_stamp=12.5)})
    message = build(MessageType.DIAGNOSTIC_ARRAY, [text], stamp=17.25)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (17, 250_000_000)
    (status,) = message.status
    assert status.name == "zephyr-1-ecg"
    shown = {value.key: float(value.value) for value in status.values}
    assert shown == {"pushed": 250.0, "lost": 3.0, "last_stamp": 12.5}


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
        messages.read_counters(text)


@given(text=st.text())
def test_reading_counters_raises_nothing_else(text: str) -> None:
    with suppress(ValueError):
        messages.read_counters(text)
