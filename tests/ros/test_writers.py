"""What goes out on each kind of topic, and what is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from std_msgs.msg import (
    Empty,
    Float32MultiArray,
    String,
)

from biosensor_common.quantities import MessageType
from biosensor_common.refusal import Refusals
from lsl_to_ros.topics.outputs import CLASSES
from lsl_to_ros.topics.writers import ChunkWriter, NumberWriter, Run, TextWriter
from tests.rigs.recorded_topics import RecordedPublisher

Refused = list[tuple[int, str]]


def run(samples: NDArray[Any]) -> Run:
    return Run(samples, np.arange(1.0, 1.0 + len(samples)), 0)


def column(values: Sequence[float], dtype: type[Any]) -> NDArray[Any]:
    return np.array(values, dtype)[:, np.newaxis]


def write(kind: MessageType, samples: NDArray[Any], refused: Refused) -> list[Any]:
    refusals = Refusals()
    publisher = RecordedPublisher(CLASSES[kind])
    writer = NumberWriter(publisher, kind, samples.shape[1], refusals)
    writer.write(run(samples))
    refused += [(each.count, each.sentence) for each in refusals.all]
    return publisher.values


@pytest.mark.parametrize(
    ("kind", "low", "high"), [(MessageType.UINT8, 0, 255), (MessageType.UINT16, 0, 65535)]
)
@pytest.mark.parametrize("dtype", [np.int32, np.float32, np.float64])
def test_what_is_beyond_an_integer_message_is_refused_alone(
    kind: MessageType, low: int, high: int, dtype: type[Any]
) -> None:
    refused: Refused = []
    values = [low, high, low - 1, 60, high + 1, 61]
    assert write(kind, column(values, dtype), refused) == [low, high, 60, 61]
    ((count, reason),) = refused
    assert count == 2
    assert str(low - 1) in reason
    assert kind.value in reason


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e30])
def test_no_integer_is_made_of_what_is_none(value: float) -> None:
    refused: Refused = []
    assert write(MessageType.UINT8, column([value, 7], np.float32), refused) == [7]
    assert [count for count, _ in refused] == [1]


def test_nothing_is_published_if_nothing_fits() -> None:
    refused: Refused = []
    assert write(MessageType.UINT8, column([-1, 256], np.int16), refused) == []
    assert [count for count, _ in refused] == [2]


def test_floats_are_never_refused() -> None:
    refused: Refused = []
    first, second, third = write(
        MessageType.FLOAT32, column([math.nan, math.inf, -0.5], np.float32), refused
    )
    assert math.isnan(first)
    assert (second, third, refused) == (math.inf, -0.5, [])


def texts(*samples: list[str]) -> NDArray[Any]:
    return np.array(samples, object)


def test_texts() -> None:
    publisher = RecordedPublisher(String)
    TextWriter(publisher, MessageType.STRING).write(run(texts(["start"], ["Ende äöü"])))
    assert [message.data for message in publisher.messages] == ["start", "Ende äöü"]


def test_several_texts_in_one_sample_can_be_told_apart() -> None:
    publisher = RecordedPublisher(String)
    TextWriter(publisher, MessageType.STRING).write(
        run(
            texts(["a, b", 'c"']),
        )
    )
    (message,) = publisher.messages
    assert json.loads(message.data) == ["a, b", 'c"']


def test_an_empty_message_says_that_something_came() -> None:
    publisher = RecordedPublisher(Empty)
    TextWriter(publisher, MessageType.EMPTY).write(run(texts(["pressed"], ["pressed"])))
    assert publisher.messages == [Empty(), Empty()]


@pytest.mark.parametrize(
    ("kind", "dtype"),
    [
        (MessageType.FLOAT32_MULTI_ARRAY, np.float32),
        (MessageType.FLOAT32_MULTI_ARRAY, np.int16),
        (MessageType.FLOAT64_MULTI_ARRAY, np.float64),
        (MessageType.INT32_MULTI_ARRAY, np.int8),
        (MessageType.INT64_MULTI_ARRAY, np.int64),
    ],
)
def test_a_chunk_is_row_major(kind: MessageType, dtype: type[Any]) -> None:
    publisher = RecordedPublisher(CLASSES[kind])
    writer = ChunkWriter(publisher, kind, 3)
    writer.add(np.array([[1, 2, 3]], dtype), 2)
    writer.add(np.array([[4, 5, 6], [7, 8, 9]], dtype), 2)
    (message,) = publisher.messages
    assert list(message.data) == [1, 2, 3, 4, 5, 6]
    assert [(dim.label, dim.size, dim.stride) for dim in message.layout.dim] == [
        ("samples", 2, 6),
        ("channels", 3, 3),
    ]
    assert writer.discard() == 1


def test_whoever_comes_late_breaks_no_chunk() -> None:
    publisher = RecordedPublisher(Float32MultiArray, readers=0)
    writer = ChunkWriter(publisher, MessageType.FLOAT32_MULTI_ARRAY, 1)
    writer.add(column([1, 2, 3], np.float32), 2)
    publisher.set_readers(1)
    writer.add(column([4], np.float32), 2)
    assert publisher.values == [[3, 4]]


def test_a_value_too_large_for_the_chunk_is_infinite_there() -> None:
    publisher = RecordedPublisher(Float32MultiArray)
    ChunkWriter(publisher, MessageType.FLOAT32_MULTI_ARRAY, 1).add(
        column([1e300, 1], np.float64), 2
    )
    assert publisher.values == [[math.inf, 1]]
