"""Keeps what came last of every stream, and makes of it what a screen can show."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Collection, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.agent.feed_frames import Samples

KEPT_S = 60.0
_HEAD = struct.Struct("<IHHI")


class Bins(NamedTuple):
    """Smallest and largest values of one stream by pixel.

    Attributes
    ----------
    numbers : shape (n,)
        Of the pixels, counted from LSL time 0; only those with a sample.
    low, high : shape (n, n_channels)
        In the units of the declaration; NaN where all are.
    """

    numbers: NDArray[np.int64]
    low: NDArray[np.float32]
    high: NDArray[np.float32]


class History:
    """What came last, by source_id.

    Parameters
    ----------
    kept_s
        For how long it is kept.
    """

    def __init__(self, kept_s: float = KEPT_S) -> None:
        self._kept_s = kept_s
        self._chunks: dict[str, deque[Samples]] = {}

    def add(self, samples: Samples) -> None:
        """Keep what has come; forget what is too old."""
        if not len(samples.stamps):
            return
        kept = self._chunks.setdefault(samples.source_id, deque())
        if kept and kept[-1].values.shape[1] != samples.values.shape[1]:
            kept.clear()
        kept.append(samples)
        oldest = samples.stamps[-1] - self._kept_s
        while kept[0].stamps[-1] < oldest:
            kept.popleft()

    def keep_only(self, source_ids: Collection[str]) -> None:
        """Forget all other streams."""
        for name in self._chunks.keys() - source_ids:
            del self._chunks[name]

    def newest(self, source_id: str) -> tuple[float, list[float | None]] | None:
        """Return stamp and values of the newest sample; None if there is none."""
        kept = self._chunks.get(source_id)
        if not kept:
            return None
        last = kept[-1]
        # JSON knows neither NaN nor infinity.
        values = [float(each) if np.isfinite(each) else None for each in last.values[-1]]
        return float(last.stamps[-1]), values

    def since(self, source_id: str, begin_s: float) -> Iterator[Samples]:
        """Yield what came after an LSL time."""
        for each in self._chunks.get(source_id, ()):
            if each.stamps[-1] > begin_s:
                yield each


def binned(chunks: Iterable[Samples], bin_s: float) -> Bins | None:
    """Reduce samples to one minimum and maximum for each pixel that has one.

    Parameters
    ----------
    chunks
        Of one stream, oldest first.
    bin_s
        Width of a pixel in seconds.

    Returns
    -------
    Bins or None
        None if there is no sample, or only text.
    """
    parts = [each for each in chunks if len(each.stamps) and each.values.shape[1]]
    if not parts:
        return None
    stamps = np.concatenate([each.stamps for each in parts])
    values = np.concatenate([each.values for each in parts])
    numbers = np.floor(stamps / bin_s).astype(np.int64)
    first = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
    low = np.fmin.reduceat(values, first, axis=0)
    high = np.fmax.reduceat(values, first, axis=0)
    return Bins(numbers[first], low, high)


def packed(index: int, bins: Bins, begin: int) -> bytes:
    """Write bins of one stream as the page reads them.

    ::

        n         uint32
        index     uint16, of the stream in what the page asked for
        channels  uint16
        first     uint32, number of the first pixel, counted from `begin`
        numbers   n uint32, counted from the first
        low       n x channels float32
        high      n x channels float32
    """
    n, channels = bins.low.shape
    first = int(bins.numbers[0])
    offsets = (bins.numbers - first).astype("<u4")
    head = _HEAD.pack(n, index, channels, first - begin)
    return b"".join(
        (
            head,
            offsets.tobytes(),
            bins.low.astype("<f4").tobytes(),
            bins.high.astype("<f4").tobytes(),
        )
    )


def newest_bins(bins: Bins, most: int) -> Bins:
    """Return the newest bins, as many as fit the screen."""
    if len(bins.numbers) <= most:
        return bins
    return Bins(bins.numbers[-most:], bins.low[-most:], bins.high[-most:])
