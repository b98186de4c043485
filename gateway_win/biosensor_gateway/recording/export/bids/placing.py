"""Gives each sample its row in a table of equal steps.

A sample belongs into the row that is nearest to its time. Where two would share a row, or time
steps back, the rows are those that are nearest to all samples together and still in the order
of the file, so that one late stamp does not move those behind it.
"""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

_HALF = 0.5 + 1e-6


def place(places: NDArray[np.float64], after: int) -> NDArray[np.int64]:
    """Return a row for each sample, ascending.

    Parameters
    ----------
    places : ndarray of float64, shape (n_samples,)
        Where each sample would be, in rows, with fractions.
    after
        The last row that is taken.

    Returns
    -------
    ndarray of int64, shape (n_samples,)
        Behind `after`, no two the same.
    """
    nearest = np.rint(places).astype(np.int64)
    if not len(nearest) or (nearest[0] > after and bool((np.diff(nearest) > 0).all())):
        return nearest
    order = np.arange(len(nearest))
    # Rows that ascend strictly are numbers that do not fall, plus 0, 1, 2 ...
    level = _without_falls((nearest - order).tolist())
    return np.maximum(level, after + 1) + order


def _without_falls(levels: list[int]) -> NDArray[np.int64]:
    """Return numbers that never fall and are away from `levels` by the least sum.

    This is isotonic regression with absolute errors. Of the cost of all levels so far, as a
    function of the last number, the heap has the places where the slope changes by one; its
    greatest is where the cost is least. A level below it pulls that place down to itself.
    """
    heap: list[int] = []
    best: list[int] = []
    for level in levels:
        heapq.heappush(heap, -level)
        if level < -heap[0]:
            heapq.heapreplace(heap, -level)
        best.append(-heap[0])
    return np.minimum.accumulate(np.array(best)[::-1])[::-1]


class Displacement:
    """How far samples are from the times of their rows."""

    def __init__(self) -> None:
        self.largest = 0.0
        """In rows."""
        self.moved = 0
        """Samples for which it is more than half a row: their own was taken."""

    def add(self, places: NDArray[np.float64], rows: NDArray[np.int64]) -> None:
        """Take in samples, where they would be and where they are; both of shape (n_samples,)."""
        away = np.abs(places - rows)
        self.largest = max(self.largest, float(away.max(initial=0.0)))
        self.moved += int(np.count_nonzero(away > _HALF))
