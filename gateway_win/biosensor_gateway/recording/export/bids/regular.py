"""Writes a regular stream as tables with evenly spaced rows, some of which may be empty."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.export.bids.file_names import NOTHING
from biosensor_gateway.recording.export.grid import Grid, Rows, part_of, write_rows
from biosensor_gateway.recording.export.tables import rows_of_numbers, table_file
from biosensor_gateway.recording.export.time_axis import Part

_EMPTY_ROWS_AT_ONCE = 4096
_MICROSECONDS = 6
_TABS = bytes.maketrans(b",", b"\t")
# For measured data, higher levels save a few percent and take several times as long.
GZIP_LEVEL = 1


@dataclass(frozen=True, slots=True)
class RegularTable:
    """The table written for a part of a stream."""

    path: Path
    start_s: float  # Time of the first row.
    samples: int
    empty_rows: int
    largest_displacement_s: float  # Largest time difference between a sample and its row.
    moved: int  # Number of samples whose own row was taken.


def write_regular(
    path: Path, batches: Iterator[Samples], part: Part, rate_hz: float
) -> RegularTable:
    """Write the table of one part: the time of each sample, then its values.

    Parameters
    ----------
    path
        Compressed if its name ends in ``.gz``.
    batches
        The samples of the part; times are seconds since zero.
    rate_hz
        Rows per second.

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


def _text(samples: Samples, count: int) -> bytes:
    times = np.round(samples.times[:count], _MICROSECONDS)
    text = rows_of_numbers(times, np.asarray(samples.values)[:count])
    return text.translate(_TABS).replace(b"NaN", NOTHING.encode())


def parts_of(batches: Iterator[Samples], parts: tuple[Part, ...]) -> Iterator[Iterator[Samples]]:
    """Yield the samples of each part; consume one part completely before the next.

    Parameters
    ----------
    parts
        The parts with their numbers of samples.
    """
    left: list[Samples] = []

    def of(count: int) -> Iterator[Samples]:
        while count:
            samples = left.pop() if left else next(batches)
            if len(samples) > count:
                left.append(part_of(samples, count, len(samples)))
                samples = part_of(samples, 0, count)
            count -= len(samples)
            yield samples

    for part in parts:
        yield of(part.count)
