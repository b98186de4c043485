"""Pieces of a run keep their samples, their stamps and their numbers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lsl_to_ros.topics.writers import Run, split

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
