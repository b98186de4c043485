"""Streams of other programs that are stamped in bursts have their beats, at the right times."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from biosensor_gateway.features.even_stamps import EvenStamps
from tests.xdf.test_pace import BURST, NOMINAL_HZ, bursts, delays, measured, overlaps, without

Array = NDArray[np.float64]

COUNT = 200 * BURST
SHAPES = {
    "bursts": bursts(delays(200)),
    "overlaps": overlaps(delays(200)),
    "a burst is lost": without(bursts(delays(200) / 10), [150 * BURST], BURST),
}


def _steadied(stamps: Array, sizes: list[int]) -> tuple[Array, Array]:
    steady = EvenStamps(NOMINAL_HZ)
    values = np.arange(len(stamps), dtype=np.float64)[:, np.newaxis]
    parts: list[tuple[Array, Array]] = []
    begin = 0
    for size in [*sizes, len(stamps)]:
        end = begin + size
        parts.append(steady.take(stamps[begin:end], values[begin:end]))
        begin = end
    parts.append(steady.finish(1))
    told, kept = (np.concatenate(each) for each in zip(*parts, strict=True))
    # Each sample is passed on once, in its order.
    assert np.array_equal(kept, values)
    return told, kept


@pytest.mark.parametrize("name", SHAPES)
def test_stamps_become_even_and_are_right(name: str) -> None:
    told, _ = _steadied(SHAPES[name], [])
    truth = measured(COUNT)
    if name == "a burst is lost":
        truth = np.delete(truth, slice(150 * BURST, 151 * BURST))
    # Before the first packet has ended, nothing tells of packets.
    late = (told - truth)[BURST:]
    # The earliest of a few packets came a little late, too; what is left is the same for all.
    assert np.ptp(late) < 0.05
    assert abs(np.median(late)) < 0.02
    steps = np.diff(told[BURST:])
    assert np.count_nonzero(steps > 0.1) == (name == "a burst is lost")
    assert np.percentile(np.abs(steps * NOMINAL_HZ - 1), 99) < 0.02


@pytest.mark.parametrize("lost", [0, 200])
def test_a_neat_stream_is_passed_as_it_is(lost: int) -> None:
    stamps = without(measured(COUNT), [2000] if lost else [], lost)
    told, _ = _steadied(stamps, [])
    assert np.array_equal(told, stamps)


@given(st.sampled_from(list(SHAPES)), st.lists(st.integers(0, 900), max_size=20))
def test_blocks_make_no_difference(name: str, sizes: list[int]) -> None:
    assert np.array_equal(_steadied(SHAPES[name], sizes)[0], _steadied(SHAPES[name], [])[0])
