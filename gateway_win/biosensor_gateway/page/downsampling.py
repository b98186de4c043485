"""Reduces samples to what a screen can show."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.agent.feed_frames import Samples

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
