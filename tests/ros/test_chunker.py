"""Chunks hold every sample once, in order, whatever is done to their length."""

from __future__ import annotations

from array import array

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lsl_to_ros.chunker import Chunker

channel_counts = st.integers(1, 5)
# Of each sample: the chunk length that holds when it arrives.
length_sequences = st.lists(st.integers(1, 40), min_size=1, max_size=200)


def sample(number: int, channels: int) -> list[float]:
    return [float(number * channels + channel) for channel in range(channels)]


@given(channels=channel_counts, lengths=length_sequences)
def test_no_sample_is_dropped_or_repeated(channels: int, lengths: list[int]) -> None:
    chunker = Chunker(channels, "d")
    out: list[float] = []
    for number, length in enumerate(lengths):
        for chunk in chunker.add(sample(number, channels), length):
            assert len(chunk) == length * channels
            out.extend(chunk)
        assert chunker.pending < length
    everything = [value for number in range(len(lengths)) for value in sample(number, channels)]
    assert out == everything[: len(out)]
    assert len(out) // channels + chunker.pending == len(lengths)


@given(channels=channel_counts, waiting=st.integers(0, 100), length=st.integers(1, 20))
def test_a_shorter_length_emits_all_chunks_that_fit(
    channels: int, waiting: int, length: int
) -> None:
    chunker = Chunker(channels, "f")
    for number in range(waiting):
        assert chunker.add(sample(number, channels), 1000) == []
    chunks = chunker.add(sample(waiting, channels), length)
    assert len(chunks) == (waiting + 1) // length
    assert chunker.pending == (waiting + 1) % length


def test_a_chunk_is_row_major() -> None:
    chunker = Chunker(3, "i")
    assert chunker.add([1, 2, 3], 2) == []
    assert chunker.add([4, 5, 6], 2) == [array("i", [1, 2, 3, 4, 5, 6])]


@given(samples=st.integers(0, 50))
def test_a_discarded_part_is_counted_and_gone(samples: int) -> None:
    chunker = Chunker(2, "f")
    for number in range(samples):
        chunker.add(sample(number, 2), 100)
    assert chunker.discard() == samples
    assert chunker.discard() == 0
    assert chunker.add([7.0, 8.0], 1) == [array("f", [7.0, 8.0])]


@pytest.mark.parametrize("bad", [[1, 2.5, 3], [1, 2**40, 3]])
def test_nothing_of_a_sample_that_does_not_fit_is_kept(bad: list[float]) -> None:
    chunker = Chunker(3, "i")
    chunker.add([1, 2, 3], 10)
    with pytest.raises((TypeError, OverflowError)):
        chunker.add(bad, 10)
    assert chunker.pending == 1
    assert chunker.add([4, 5, 6], 2) == [array("i", [1, 2, 3, 4, 5, 6])]
