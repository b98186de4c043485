"""What two recorders kept of one stream, in one form, and what differs between them."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pylsl
from numpy.typing import NDArray

Times = NDArray[np.int64]

# Where one recording may begin in the other: no two samples of one time differ by more.
_SAME_TIME_NS = 10_000_000


@dataclass(frozen=True)
class Track:
    """Samples of one stream, in the order of recording."""

    times_ns: Times  # When each was measured, as system time.
    # Shape [samples, channels]: int64 for a stream of 64-bit integers, `str` objects for text,
    # float64 for all others.
    values: NDArray[Any]
    # labels, units: one a channel; empty for text.
    labels: tuple[str, ...] = ()
    units: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.times_ns)

    def part(self, start: int, length: int) -> Track:
        """Return consecutive samples."""
        rows = slice(start, start + length)
        return Track(self.times_ns[rows], self.values[rows], self.labels, self.units)


class Errors(NamedTuple):
    """Differences of the times of the same samples, in nanoseconds."""

    worst: float
    rms: float


def with_columns(texts: Track) -> Track:
    """Return texts that are JSON lists with a column for each element."""
    rows = [json.loads(text) for text in texts.values[:, 0]]
    return Track(texts.times_ns, np.array(rows, object).reshape(len(rows), -1))


def same_values(one: Track, other: Track) -> bool:
    """Whether both hold the same values; NaN is a value."""
    if one.values.shape != other.values.shape:
        return False
    # The numbers are compared exactly: float32 and 32-bit integers fit into a float64.
    has_nan = one.values.dtype == np.float64
    return np.array_equal(one.values, other.values, equal_nan=has_nan)


def place_of(part: Track, whole: Track) -> int | None:
    """Return the index in *whole* at which *part* is found, None if it is nowhere.

    All of its samples have to be there, in order, without another one between.
    """
    near = np.abs(whole.times_ns - part.times_ns[0]) < _SAME_TIME_NS
    for start in np.flatnonzero(near).tolist():
        if same_values(whole.part(start, len(part)), part):
            return start
    return None


def time_errors(one: Track, other: Track) -> Errors:
    """Compare the times of as many samples."""
    differences = (one.times_ns - other.times_ns).astype(np.float64)
    return Errors(float(np.abs(differences).max()), float(np.sqrt(np.mean(np.square(differences)))))


NS_PER_S = 1_000_000_000
READINGS = 100


def system_minus_lsl_ns() -> int:
    """Return system time minus LSL time, from the narrowest of many bracketed readings."""
    readings: list[tuple[int, int]] = []
    for _ in range(READINGS):
        before, lsl_s, after = time.time_ns(), pylsl.local_clock(), time.time_ns()
        readings.append((after - before, (before + after) // 2 - round(lsl_s * NS_PER_S)))
    return min(readings)[1]


class Sample(NamedTuple):
    """A sample as it was received."""

    sequence: int
    time_ns: int
    values: tuple[Any, ...]  # One a channel; of an event its text alone.


def samples_of(messages: Iterable[Mapping[str, Any]]) -> list[Sample]:
    """Return all samples of ``Samples`` and ``Event`` messages.

    Raises
    ------
    AssertionError
        If a message's values do not fit its number of samples and channels.
    """
    return [sample for message in messages for sample in _samples(message)]


def _samples(message: Mapping[str, Any]) -> list[Sample]:
    stamp, sequence = message["header"]["stamp"], message["sequence"]
    start_ns = stamp["sec"] * NS_PER_S + stamp["nanosec"]
    if isinstance(message["data"], str):
        return [Sample(sequence, start_ns, (message["data"],))]
    offsets, channels = message["offsets_ns"], len(message["labels"])
    # A stream of 64-bit integers has no data, any other has no integers.
    values = message["data"] or message["integers"]
    assert len(values) == len(message["data"]) + len(message["integers"])
    assert len(values) == len(offsets) * channels
    assert offsets[0] == 0
    return [
        Sample(
            sequence + row,
            start_ns + offset,
            tuple(values[row * channels : (row + 1) * channels]),
        )
        for row, offset in enumerate(offsets)
    ]
