"""Pieces of a run and chunks: they hold every sample once, in order, with its stamp."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lsl_to_ros.topics.writers import Chunker, Run, split

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
