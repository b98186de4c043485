"""Reduces samples to what a screen can show."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Any, NamedTuple

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


DRAWN_CHANNELS = 8
"""Of one stream at a time; which ones can be chosen."""
MAX_ROWS_HZ = 500.0
"""Faster streams are kept as smallest and largest value of short spans."""
_BIN_S = 2.0 / MAX_ROWS_HZ


def key_of(number: int, first: int = 0) -> str:
    """Return by which name a browser asks for channels of a stream, from the `first` on."""
    return f"{number}:{first}" if first else str(number)


def chosen(keys: Iterable[str]) -> dict[int, set[int]]:
    """Return what browsers ask for: the first channels of each window, by the stream's number.

    What cannot be a name of `key_of` is left out.
    """
    found: dict[int, set[int]] = {}
    for key in keys:
        number, _, first = key.partition(":")
        if number.isdecimal() and (first or "0").isdecimal() and len(key) < 20:
            found.setdefault(int(number), set()).add(int(first or "0"))
    return found


def window(
    key: str, times: NDArray[np.float64], samples: NDArray[Any], first: int, rate: float
) -> Samples:
    """Return some channels of what came, as float32 and with NaN for whatever is not finite.

    Parameters
    ----------
    times : shape (n,)
        Local LSL time.
    samples : shape (n, n_channels)
    first
        Number of the first channel, from 0.
    rate
        Nominal, in Hz, or what really came if that is more.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        values = samples[:, first : first + DRAWN_CHANNELS].astype(np.float32)
    values[~np.isfinite(values)] = np.nan
    found = Samples(key, times, values)
    return _thinned(found) if rate > MAX_ROWS_HZ else found


def measured_rate(times: NDArray[np.float64]) -> float:
    """Return the rate of samples in Hz by their own times; 0 for too few to say.

    How many come at once says nothing: what has waited is no faster.
    """
    if len(times) < MAX_ROWS_HZ / 10:
        return 0.0
    return (len(times) - 1) / max(float(times[-1] - times[0]), _BIN_S)


def _thinned(samples: Samples) -> Samples:
    bins = binned([samples], _BIN_S)
    if bins is None:
        return samples
    quarters = np.array([0.25, 0.75])
    stamps = ((bins.numbers[:, np.newaxis] + quarters) * _BIN_S).ravel().astype(np.float64)
    values = np.stack((bins.low, bins.high), axis=1).reshape(len(stamps), -1)
    return Samples(samples.source_id, stamps, values)
