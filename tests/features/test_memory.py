"""What detectors keep does not grow with time."""

from __future__ import annotations

import gc
import sys
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.features.chains import new_runs
from biosensor_gateway.features.witnesses import Motion, Warmth, Witness
from tests.features import signals
from tests.features.signals import Array

_MINUTES = 7
"""Longer than all that is kept: windows of 5 min, and a minute more of their quality."""
_SIGNALS: dict[str, tuple[Array, float]] = {
    "ECG": (signals.ecg(80, 60 * _MINUTES)[0], 80.0),
    "PPG": (signals.pulse(20, 60 * _MINUTES)[0], 20.0),
    "GSR": (signals.skin(8, 60 * _MINUTES)[0], 8.0),
    "Respiration": (signals.breaths(10, 60 * _MINUTES, 15, coughs=True)[0], 10.0),
    "Accelerometer": (np.tile([0.0, 0.6, 0.8], (600 * _MINUTES, 1)), 10.0),
    "RR": (np.full(75 * _MINUTES, 0.8), 0.0),
}


def _bytes(root: Any) -> int:
    """Bytes of all that hangs on an object, without classes, functions and modules."""
    seen: set[int] = set()
    left, total = [root], 0
    while left:
        each = left.pop()
        if id(each) in seen or isinstance(each, type(gc) | type | type(_bytes)):
            continue
        seen.add(id(each))
        total += sys.getsizeof(each)
        left += gc.get_referents(each)
    return total


@pytest.mark.parametrize("kind", _SIGNALS)
def test_what_is_kept_once_all_windows_are_full_grows_no_more(kind: str) -> None:
    values, rate = _SIGNALS[kind]
    runs = new_runs(kind, rate, foreign=False)
    stamps = np.arange(len(values)) / (rate or 1.25)
    columns = values.reshape(len(values), -1)
    sizes: list[int] = []
    block = max(1, round(rate))
    for repeat in range(4):
        for begin in range(0, len(values), block):
            here = slice(begin, begin + block)
            runs.take(stamps[here] + repeat * 60 * _MINUTES, columns[here])
        sizes.append(_bytes(runs))
    # One number more for each ten seconds would be more than this.
    assert max(sizes[1:]) < sizes[0] + 4096
    assert max(sizes) < 2_000_000


@pytest.mark.parametrize(
    ("witness", "columns"),
    [(Warmth(keep_s=60), 1), (Motion(4.0, foreign=False, keep_s=60), 3)],
    ids=["temperature", "acceleration"],
)
def test_what_other_streams_say_is_forgotten_in_time(witness: Witness, columns: int) -> None:
    sizes: list[int] = []
    for begin_s in range(0, 1200, 60):
        witness.take(begin_s + np.arange(240) / 4, np.full((240, columns), 33.0))
        sizes.append(_bytes(witness))
    # It is kept for 60 s at least, and twice that at most.
    assert max(sizes) <= 1.3 * max(sizes[:3])
