"""Pieces of a run and chunks: they hold every sample once, in order, with its stamp."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from std_msgs.msg import Empty, Float32MultiArray, String

from biosensor_common.quantities import MessageType
from biosensor_common.refusal import Refusals
from lsl_to_ros.topics.outputs import CLASSES
from lsl_to_ros.topics.writers import Chunker, ChunkWriter, NumberWriter, Run, TextWriter, split
from tests.rigs.recorded_topics import RecordedPublisher

# Pieces of a run keep their samples, their stamps and their numbers.

choices = st.lists(st.booleans(), min_size=1, max_size=40)


def run_of(count: int, sequence: int) -> Run:
    """Make a run whose samples and stamps say their places."""
    places = np.arange(count, dtype=np.float64)
    return Run(np.stack([places, -places], axis=1), 100.0 + places, sequence)


@settings(deadline=None)
@given(chosen=choices, sequence=st.integers(0, 2**40), alone=st.booleans())
def test_the_pieces_are_the_chosen_samples_in_order(
    chosen: list[bool], sequence: int, alone: bool
) -> None:
    pieces = split(run_of(len(chosen), sequence), np.array(chosen), alone=alone)
    wanted = [place for place, is_chosen in enumerate(chosen) if is_chosen]
    found: list[int] = []
    for piece in pieces:
        places = [int(place) for place in piece.samples[:, 0]]
        assert places == list(range(places[0], places[0] + len(places)))
        assert piece.samples[:, 1].tolist() == [-place for place in places]
        assert piece.stamps.tolist() == [100.0 + place for place in places]
        assert piece.sequence == sequence + places[0]
        found += places
    assert found == wanted


@settings(deadline=None)
@given(chosen=choices)
def test_there_are_no_more_pieces_than_there_must_be(chosen: list[bool]) -> None:
    pieces = split(run_of(len(chosen), 0), np.array(chosen), alone=False)
    for before, after in pairwise(pieces):
        assert after.sequence > before.sequence + len(before.stamps)


@settings(deadline=None)
@given(chosen=choices)
def test_each_sample_can_be_a_piece_of_its_own(chosen: list[bool]) -> None:
    pieces = split(run_of(len(chosen), 0), np.array(chosen), alone=True)
    assert [len(piece.stamps) for piece in pieces] == [1] * sum(chosen)


# Chunks hold every sample once, in order, whatever is done to their length.
class Add(NamedTuple):
    """So many samples at once, and the length that holds when they come."""

    samples: int
    length: int


class Discard(NamedTuple):
    """A gap."""


additions = st.builds(Add, st.integers(0, 60), st.integers(1, 40))
sizes = st.integers(1, 24)


def sample(number: int, size: int) -> bytes:
    """Make a sample that no other one is equal to."""
    return number.to_bytes(4, "little")[:size].ljust(size, b"\xff")


def block(start: int, count: int, size: int) -> bytes:
    return b"".join(sample(number, size) for number in range(start, start + count))


@settings(deadline=None)
@given(size=st.integers(2, 24), steps=st.lists(additions | st.builds(Discard), max_size=60))
def test_no_sample_is_dropped_or_repeated(size: int, steps: list[Add | Discard]) -> None:
    chunker = Chunker(size)
    pending = b""
    number = 0
    for step in steps:
        if isinstance(step, Discard):
            assert chunker.discard() * size == len(pending)
            pending = b""
            continue
        values = block(number, step.samples, size)
        number += step.samples
        pending += values
        for chunk in chunker.add(values, step.length):
            assert len(chunk) == step.length * size
            assert pending.startswith(chunk)
            pending = pending[len(chunk) :]
        assert chunker.pending * size == len(pending)
        assert chunker.pending < step.length


@given(size=sizes, waiting=st.integers(0, 100), length=st.integers(1, 20))
def test_a_shorter_length_emits_all_chunks_that_fit(size: int, waiting: int, length: int) -> None:
    chunker = Chunker(size)
    assert chunker.add(block(0, waiting, size), 1000) == []
    chunks = chunker.add(sample(waiting, size), length)
    assert len(chunks) == (waiting + 1) // length
    assert chunker.pending == (waiting + 1) % length


@given(size=sizes, counts=st.lists(st.integers(0, 30), max_size=20), length=st.integers(1, 20))
def test_one_by_one_and_in_blocks_the_chunks_are_the_same(
    size: int, counts: list[int], length: int
) -> None:
    singly, in_blocks = Chunker(size), Chunker(size)
    total = sum(counts)
    one_by_one = [
        chunk for number in range(total) for chunk in singly.add(sample(number, size), length)
    ]
    together: list[bytes] = []
    for place, count in enumerate(counts):
        together += in_blocks.add(block(sum(counts[:place]), count, size), length)
    assert together == one_by_one
    assert in_blocks.pending == singly.pending


@given(samples=st.integers(0, 50))
def test_a_discarded_part_is_counted_and_gone(samples: int) -> None:
    chunker = Chunker(8)
    chunker.add(block(0, samples, 8), 100)
    assert chunker.discard() == samples
    assert chunker.discard() == 0
    assert chunker.add(sample(7, 8), 1) == [sample(7, 8)]


def test_what_was_handed_out_does_not_change() -> None:
    chunker = Chunker(1)
    first, second = chunker.add(b"abcde", 2)
    chunker.add(b"fgh", 2)
    chunker.discard()
    assert (first, second) == (b"ab", b"cd")


# What goes out on each kind of topic, and what is refused.

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
