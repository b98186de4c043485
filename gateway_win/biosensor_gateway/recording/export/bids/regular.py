"""Writes a regular stream as tables of equal steps, of which some rows may be empty."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.export.batches import joined
from biosensor_gateway.recording.export.bids.tables import NOTHING
from biosensor_gateway.recording.export.bids.timing import Part
from biosensor_gateway.recording.export.csv.tables import table_file
from biosensor_gateway.recording.export.numbers import rows_of_numbers

_WINDOW_S = 1.0
_LEAST_WINDOW, _MOST_WINDOW = 16, 4096
_EMPTY_ROWS_AT_ONCE = 4096
_MICROSECONDS = 6
_TABS = bytes.maketrans(b",", b"\t")
# Of what was measured, higher levels leave a few percent less, and take several times as long.
GZIP_LEVEL = 1
_HALF = 0.5 + 1e-6


@dataclass(frozen=True, slots=True)
class RegularTable:
    """What became of a part of a stream.

    Attributes
    ----------
    start_s
        Time of the first row.
    largest_displacement_s
        How far a sample is from the time of its row at most.
    moved
        Samples whose own row was another one's.
    """

    path: Path
    start_s: float
    samples: int
    empty_rows: int
    largest_displacement_s: float
    moved: int


def write_regular(
    path: Path, batches: Iterator[Samples], part: Part, rate_hz: float
) -> RegularTable:
    """Write the table of one part: the time of each sample, then its values.

    Parameters
    ----------
    path
        Packed if its name ends in ``.gz``.
    batches
        The samples of the part; times are seconds since zero.
    rate_hz
        Rows a second.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with table_file(path, is_packed=path.suffix == ".gz", level=GZIP_LEVEL) as file:
        writer = fill(TextRows(file), batches, part, rate_hz)
    return RegularTable(
        path,
        part.start_s + writer.first_row / rate_hz,
        writer.samples,
        writer.last_row + 1 - writer.first_row - writer.samples,
        writer.displacement.largest / rate_hz,
        writer.displacement.moved,
    )


def fill(to: Rows, batches: Iterator[Samples], part: Part, rate_hz: float) -> Grid:
    """Write the rows of one part; see :func:`write_regular`."""
    grid = Grid(to, part.start_s, rate_hz)
    for _ in write_rows(grid, batches):
        pass
    return grid


def write_rows(grid: Grid, batches: Iterator[Samples]) -> Iterator[int]:
    """Write samples to a grid; after each piece, give how many that were."""
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


class Rows(Protocol):
    """Where the rows of a table go."""

    def write(self, samples: Samples, count: int) -> None:
        """Write the first `count` samples, a row each."""
        ...

    def leave_empty(self, rows: int, width: int) -> None:
        """Write rows of so many channels in which there is nothing."""
        ...


class TextRows:
    """Writes lines: the time of each sample, then its values."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def write(self, samples: Samples, count: int) -> None:
        """See :class:`Rows`."""
        self._file.write(_text(samples, count))

    def leave_empty(self, rows: int, width: int) -> None:
        """See :class:`Rows`."""
        nothing = b"\t".join([NOTHING.encode()] * (1 + width)) + b"\n"
        while rows:
            some = min(rows, _EMPTY_ROWS_AT_ONCE)
            self._file.write(nothing * some)
            rows -= some


class Grid:
    """Puts samples into rows of equal steps, of which some may stay empty."""

    def __init__(self, to: Rows, start_s: float, rate_hz: float) -> None:
        self._to = to
        self._start_s = start_s
        self.rate_hz = rate_hz
        self.first_row = 0
        self.last_row = np.iinfo(np.int64).min // 2
        self.samples = 0
        self.displacement = Displacement()

    def write(self, samples: Samples, count: int) -> Samples:
        """Write the first samples, of which those behind them have a say; return the others."""
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
        return _cut(samples, count, len(samples))

    def _write_with_gaps(self, samples: Samples, count: int, empty: NDArray[np.int64]) -> None:
        width = np.asarray(samples.values).shape[1]
        before = 0
        for at in np.flatnonzero(empty).tolist():
            if at > before:
                self._to.write(_cut(samples, before, at), at - before)
            self._to.leave_empty(int(empty[at]), width)
            before = at
        self._to.write(_cut(samples, before, count), count - before)


def _text(samples: Samples, count: int) -> bytes:
    times = np.round(samples.times[:count], _MICROSECONDS)
    text = rows_of_numbers(times, np.asarray(samples.values)[:count])
    return text.translate(_TABS).replace(b"NaN", NOTHING.encode())


def parts_of(batches: Iterator[Samples], parts: tuple[Part, ...]) -> Iterator[Iterator[Samples]]:
    """Give the samples of each part; take all of one before the next.

    Parameters
    ----------
    batches
        All samples of the stream.
    parts
        How many each has.
    """
    left: list[Samples] = []

    def of(count: int) -> Iterator[Samples]:
        while count:
            samples = left.pop() if left else next(batches)
            if len(samples) > count:
                left.append(_cut(samples, count, len(samples)))
                samples = _cut(samples, 0, count)
            count -= len(samples)
            yield samples

    for part in parts:
        yield of(part.count)


def _cut(samples: Samples, begin: int, end: int) -> Samples:
    return Samples(samples.times[begin:end], samples.stamps[begin:end], samples.values[begin:end])


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
