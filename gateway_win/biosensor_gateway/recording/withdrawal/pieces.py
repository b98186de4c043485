"""Finds pieces of removed data in files of any format that this program writes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.export.tables import numbers
from biosensor_gateway.recording.withdrawal.traces import signals_of_edf

SAMPLES = 8
_FEWEST_VALUES = 4
_MOST_PIECES = 400
_BETWEEN_CELLS = re.compile(rb"[,;\t ]")
# A signal in EDF may have another unit, and rounded values; a piece must vary by so many steps.
_UNITS = (1.0, 1e3, 1e6, 1e-3, 1e-6)
_STEPS = 64


@dataclass(slots=True)
class Pieces:
    """Pieces of the removed data, in the forms in which files may contain them."""

    found: list[bytes] = field(default_factory=list[bytes])
    # By the text of their first value: texts of values that are below each other in a table.
    _columns: dict[bytes, list[list[bytes]]] = field(default_factory=dict[bytes, list[list[bytes]]])
    _signals: list[NDArray[np.float64]] = field(default_factory=list[NDArray[np.float64]])

    def take(self, samples: Samples) -> None:
        """Add pieces from some samples of a numeric stream."""
        if len(self.found) >= _MOST_PIECES or isinstance(samples.values, list):
            return
        values = samples.values[:SAMPLES]
        if len(values) < SAMPLES or len(np.unique(values)) < _FEWEST_VALUES:
            return
        self.found += _forms(values)
        liveliest = max(values.T, key=lambda each: len(np.unique(each)))
        for column in (liveliest, values.ravel()[:SAMPLES]):
            if len(np.unique(column)) >= _FEWEST_VALUES:
                told = numbers(column)
                self._columns.setdefault(told[0], []).append(told)
        self._signals.append(liveliest.astype(np.float64))

    def in_bytes(self, content: bytes) -> bool:
        """Whether bytes contain one of them."""
        return any(each in content for each in self.found)

    def in_rows(self, rows: Iterable[bytes]) -> bool:
        """Whether some rows of a table contain one of them in a column."""
        waiting: list[tuple[int, int, list[bytes]]] = []
        for row in rows:
            cells = _BETWEEN_CELLS.split(row.strip())
            waiting = [
                (column, count + 1, piece)
                for column, count, piece in waiting
                if column < len(cells) and cells[column] == piece[count]
            ]
            if any(count == len(piece) for _, count, piece in waiting):
                return True
            waiting += [
                (column, 1, piece)
                for column, cell in enumerate(cells)
                for piece in self._columns.get(cell, ())
            ]
        return False

    def in_edf(self, path: Path) -> bool:
        """Whether a signal in an EDF or BDF file contains one of them.

        Raises
        ------
        ValueError
            If it is neither EDF nor BDF.
        """
        return any(
            _is_in(signal, step, np.array(self._signals) * factor)
            for signal, step in (signals_of_edf(path, SAMPLES - 1) if self._signals else ())
            for factor in _UNITS
        )

    @property
    def longest(self) -> int:
        """Length of the longest piece in bytes."""
        return max(map(len, self.found), default=0)


def _forms(values: NDArray[Any]) -> Iterator[bytes]:
    yield values.tobytes()
    for form in ("<f8", "<f4"):
        if values.dtype != form:
            yield values.astype(form).tobytes()
    if values.shape[1] == 1:
        yield b"\n".join(numbers(values))


def _is_in(signal: NDArray[np.float64], step: float, pieces: NDArray[np.float64]) -> bool:
    """Whether one of some pieces, shape (n, `SAMPLES`), is in a signal with rounded values."""
    pieces = pieces[np.ptp(pieces, axis=1) > _STEPS * step]
    pieces = pieces[np.argsort(pieces[:, 0])]
    begins = signal[: len(signal) - SAMPLES + 1]
    low, high = (np.searchsorted(pieces[:, 0], begins + away) for away in (-step, step))
    places = np.flatnonzero(high > low)
    for number in range(int((high - low).max(initial=0))):
        places = places[low[places] + number < high[places]]
        windows = signal[places[:, np.newaxis] + np.arange(SAMPLES)]
        if (np.abs(windows - pieces[low[places] + number]) <= step).all(axis=1).any():
            return True
    return False


def blocks(parts: Iterable[bytes], overlap: int) -> Iterator[bytes]:
    """Yield parts with the last `overlap` bytes before them, to find matches across borders."""
    rest = b""
    for part in parts:
        block = rest + part
        yield block
        rest = block[-overlap:] if overlap else b""
