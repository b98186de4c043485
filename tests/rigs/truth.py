"""What came from a virtual device, held against what it measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def assert_once_and_in_order(part: list[list[float]], whole: Floats) -> list[int]:
    """Assert that all samples are the device's, each once; return where they lie."""
    received = np.asarray(part, np.float64)
    places: list[int] = []
    begin = 0
    while len(places) < len(received):
        rest = received[len(places) :]
        # Values repeat; five in a row do not.
        enough = min(5, len(rest))
        begin = next((k for k in range(begin, len(whole)) if _same(rest, whole[k:]) >= enough), -1)
        assert begin >= 0, "what was emitted is no part of what was sent"
        count = _same(rest, whole[begin:])
        places += range(begin, begin + count)
        begin += count
    return places


def _same(received: Floats, sent: Floats) -> int:
    """Count how many samples are equal, from the first one on."""
    count = min(len(received), len(sent))
    differ = ~np.all(np.isclose(received[:count], sent[:count], rtol=1e-6, equal_nan=True), axis=1)
    return int(np.argmax(differ)) if differ.any() else count
