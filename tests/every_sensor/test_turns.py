"""Sensors take turns where all at once would be more than the computer carries."""

from __future__ import annotations

from collections import Counter
from itertools import chain

from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.registry import sensor_names
from tests.rigs.turns import turn_of, turns

NAMES = st.lists(st.sampled_from(sensor_names()), unique=True, min_size=1)


@given(NAMES, st.integers(1, 9))
def test_each_has_one_turn_and_no_turn_has_too_many(names: list[str], most: int) -> None:
    dealt = turns(names, most)
    assert Counter(chain.from_iterable(dealt)) == Counter(names)
    sizes = [len(turn) for turn in dealt]
    assert max(sizes) <= most
    assert max(sizes) - min(sizes) <= 1
    assert len(dealt) == -(-len(names) // most)
    for name in names:
        assert name in turn_of(name, dealt)
    for turn in dealt:
        assert list(turn) == [name for name in names if name in turn]
