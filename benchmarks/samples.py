"""What a sample carries, and how its sending and its arrival are joined.

A sample has its number in channel 0. The sender notes a time for each number, so does
the receiver, and the parent joins them: no stamp has to survive float32, which holds
integers below 2**24. ``time.monotonic`` is one clock for all processes of a Linux machine.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

CHANNELS = 8
RATE_HZ = 256.0
CONTENT_TYPE = "EEG"
# Number of what is sent before and after the samples that count.
FILLER = -1.0
_GAPS = 100


def stream_names(count: int) -> list[str]:
    """Return the LSL names of so many streams."""
    return [f"bench{number:03d}" for number in range(count)]


def topic_of(name: str) -> str:
    """Return the topic that the node gives to the stream of that name."""
    return f"/biosensors/{name}/{CONTENT_TYPE}"


def values_of(number: float) -> list[float]:
    """Return the sample of that number; the other channels are of no importance."""
    return [number, *(0.125 * channel for channel in range(1, CHANNELS))]


class Arrivals:
    """Times of arrival by stream and number, NaN where nothing arrived.

    Each stream may be noted by a thread of its own.
    """

    def __init__(self, streams: int, count: int) -> None:
        self._times = np.full((streams, count), np.nan)
        self._missing = streams * [count]
        self._repeated = streams * [0]

    @property
    def is_complete(self) -> bool:
        """Whether everything has arrived."""
        return not any(self._missing)

    @property
    def repeated(self) -> int:
        """Samples that arrived again."""
        return sum(self._repeated)

    def add(self, stream: int, number: float) -> None:
        """Note that a sample is here."""
        now = time.monotonic()
        if number >= 0:
            is_new = math.isnan(self._times[stream, int(number)])
            self._times[stream, int(number)] = now
            self._count(stream, 1, int(is_new))

    def add_chunk(self, stream: int, numbers: NDArray[np.float32]) -> None:
        """Note that several are here at once."""
        now = time.monotonic()
        counted = numbers[numbers >= 0].astype(np.intp)
        distinct = np.unique(counted)
        new = np.count_nonzero(np.isnan(self._times[stream, distinct]))
        self._times[stream, distinct] = now
        self._count(stream, len(counted), int(new))

    def write(self, file: Path) -> None:
        """Write all times, shape [streams, count]."""
        np.save(file, self._times)

    def _count(self, stream: int, arrived: int, new: int) -> None:
        self._missing[stream] -= new
        self._repeated[stream] += arrived - new


@dataclass(frozen=True, slots=True)
class Passage:
    """What became of the samples of one round."""

    # p50_ms, p99_ms, worst_ms: latency from just before the sender's call to the receiver's first
    # statement.
    p50_ms: float
    p99_ms: float
    worst_ms: float
    # sent, lost, repeated: samples.
    sent: int
    lost: int
    repeated: int
    # What was lost: stream, first number, how many; the first of them.
    gaps: Sequence[tuple[int, int, int]]


def passage(sent: NDArray[np.float64], arrived: NDArray[np.float64], repeated: int) -> Passage:
    """Join times of sending with times of arrival, both of shape [streams, count].

    Raises
    ------
    ValueError
        If nothing arrived.
    """
    is_lost = np.isnan(arrived)
    latency_ms = 1e3 * (arrived - sent)[~is_lost]
    if not len(latency_ms):
        raise ValueError("nothing arrived of what was sent")
    p50, p99 = np.percentile(latency_ms, (50, 99))
    return Passage(
        p50_ms=float(p50),
        p99_ms=float(p99),
        worst_ms=float(latency_ms.max()),
        sent=sent.size,
        lost=int(is_lost.sum()),
        repeated=repeated,
        gaps=_gaps(is_lost)[:_GAPS],
    )


def _gaps(is_lost: NDArray[np.bool_]) -> list[tuple[int, int, int]]:
    """Return runs of what was lost, as in `Passage`."""
    edges = np.diff(is_lost.astype(np.int8), axis=1, prepend=0, append=0)
    begins, ends = (np.argwhere(edges == edge) for edge in (1, -1))
    return [
        (int(stream), int(begin), int(end - begin))
        for (stream, begin), (_, end) in zip(begins, ends, strict=True)
    ]
