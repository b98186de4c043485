"""Packet numbers of boards that count, and of those that do not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.brainflow.driver.emitter import SampleCount


@given(
    turn=st.sampled_from([201, 256]),
    first=st.integers(0, 200),
    lost=st.sets(st.integers(1, 998)),
    cuts=st.lists(st.integers(1, 60), min_size=30, max_size=60),
)
def test_what_is_missing_is_counted_and_keeps_its_place(
    turn: int, first: int, lost: set[int], cuts: list[int]
) -> None:
    kept = np.array([place for place in range(1000) if place not in lost])
    # More than a turn in a row cannot be seen in the number.
    if np.diff(kept).max() >= turn:
        return
    count = SampleCount(turn)
    places: list[int] = []
    missing = 0
    begin = 0
    for cut in [*cuts, 1000]:
        part = kept[begin : begin + cut]
        begin += cut
        if len(part):
            found, gone = count.place(((first + part) % turn).astype(np.float64))
            places += found.tolist()
            missing += gone
    assert places == kept.tolist()
    assert missing == 1000 - len(kept) - (999 - kept[-1])


@pytest.mark.parametrize("numbers", [[5.0, 5.0, 5.0, 5.0], [9.0, 1.0, 700.0, 3.0]])
def test_a_board_that_counts_nothing_loses_nothing(numbers: list[float]) -> None:
    places, missing = SampleCount(0).place(np.array(numbers))
    assert places.tolist() == [0, 1, 2, 3]
    assert missing == 0
