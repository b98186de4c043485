"""Assigns samples to evenly spaced rows by their times; some rows stay empty."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.export.runs import joined

_WINDOW_S = 1.0
_LEAST_WINDOW, _MOST_WINDOW = 16, 4096
_HALF = 0.5 + 1e-6


class Rows(Protocol):
    """Output for the rows of a table."""

    def write(self, samples: Samples, count: int) -> None:
        """Write the first `count` samples, one row each."""
        ...

    def leave_empty(self, rows: int, width: int) -> None:
        """Write empty rows with `width` channels."""
        ...


class Grid:
    """Assigns samples to evenly spaced rows, some of which may stay empty."""

    def __init__(self, to: Rows, start_s: float, rate_hz: float) -> None:
        self._to = to
        self._start_s = start_s
        self.rate_hz = rate_hz
        self.first_row = 0
        self.last_row = np.iinfo(np.int64).min // 2
        self.samples = 0
        self.displacement = Displacement()

    def write(self, samples: Samples, count: int) -> Samples:
        """Write the first `count` samples, placed in view of the others; return the others."""
        places = (samples.times - self._start_s) * self.rate_hz
        rows = place(places, self.last_row)[:count]
        self.displacement.add(places[:count], rows)
        if not self.samples:
            self.first_row = int(rows[0])
            self.last_row = self.first_row - 1
        empty = np.diff(rows, prepend=self.last_row) - 1
        if empty.any():
            self._write_with_gaps(samples, count, empty)
        else:
            self._to.write(samples, count)
        self.last_row = int(rows[-1])
        self.samples += count
        return part_of(samples, count, len(samples))

    def _write_with_gaps(self, samples: Samples, count: int, empty: NDArray[np.int64]) -> None:
        width = np.asarray(samples.values).shape[1]
        before = 0
        for at in np.flatnonzero(empty).tolist():
            if at > before:
                self._to.write(part_of(samples, before, at), at - before)
            self._to.leave_empty(int(empty[at]), width)
            before = at
        self._to.write(part_of(samples, before, count), count - before)


def write_rows(grid: Grid, batches: Iterator[Samples]) -> Iterator[int]:
    """Write samples to a grid; yield the number of samples of each block."""
    window = int(np.clip(np.ceil(grid.rate_hz * _WINDOW_S), _LEAST_WINDOW, _MOST_WINDOW))
    kept: Samples | None = None
    for samples in batches:
        kept = samples if kept is None else joined([kept, samples])
        if len(kept) >= 2 * window:
            written = len(kept) - window
            kept = grid.write(kept, written)
            yield written
    if kept is not None:
        grid.write(kept, len(kept))
        yield len(kept)


def part_of(samples: Samples, begin: int, end: int) -> Samples:
    """Return the samples from `begin` to before `end`."""
    return Samples(samples.times[begin:end], samples.stamps[begin:end], samples.values[begin:end])


def place(places: NDArray[np.float64], after: int) -> NDArray[np.int64]:
    """Return a row number for each sample, strictly ascending.

    Parameters
    ----------
    places : ndarray of float64, shape (n_samples,)
        Exact position of each sample, in fractional rows.
    after
        The last row already used.

    Returns
    -------
    ndarray of int64, shape (n_samples,)
        Greater than `after` and all different.
    """
    nearest = np.rint(places).astype(np.int64)
    if not len(nearest) or (nearest[0] > after and bool((np.diff(nearest) > 0).all())):
        return nearest
    order = np.arange(len(nearest))
    # Strictly ascending rows are non-decreasing numbers plus 0, 1, 2 ...
    level = _without_falls((nearest - order).tolist())
    return np.maximum(level, after + 1) + order


def _without_falls(levels: list[int]) -> NDArray[np.int64]:
    """Return the non-decreasing numbers with the least sum of distances from `levels`."""
    # This is isotonic regression with absolute errors. The heap contains the points at which the
    # slope of the cost, as a function of the last number, changes by one; the cost is least at the
    # greatest point. A lower level replaces that point by itself.
    heap: list[int] = []
    best: list[int] = []
    for level in levels:
        heapq.heappush(heap, -level)
        if level < -heap[0]:
            heapq.heapreplace(heap, -level)
        best.append(-heap[0])
    return np.minimum.accumulate(np.array(best)[::-1])[::-1]


class Displacement:
    """Statistics of the distances between samples and their rows."""

    def __init__(self) -> None:
        self.largest = 0.0
        """Largest distance in rows."""
        self.moved = 0
        """Number of samples with more than half a row, because their own row was taken."""

    def add(self, places: NDArray[np.float64], rows: NDArray[np.int64]) -> None:
        """Add samples by their exact positions and their rows, both of shape (n_samples,)."""
        away = np.abs(places - rows)
        self.largest = max(self.largest, float(away.max(initial=0.0)))
        self.moved += int(np.count_nonzero(away > _HALF))
