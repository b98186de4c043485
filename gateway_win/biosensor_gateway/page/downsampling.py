"""Reduces samples to the resolution of a screen."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.agent.feed_frames import Samples

_HEAD = struct.Struct("<IHHI")


class Bins(NamedTuple):
    """Minimum and maximum of one stream for each pixel.

    Attributes
    ----------
    numbers : shape (n,)
        Numbers of the pixels that have a sample, counted from LSL time 0.
    low, high : shape (n, n_channels)
        In the units of the declaration; NaN if all values of the pixel are NaN.
    """

    numbers: NDArray[np.int64]
    low: NDArray[np.float32]
    high: NDArray[np.float32]


def binned(chunks: Iterable[Samples], bin_s: float) -> Bins | None:
    """Reduce samples to a minimum and a maximum for each pixel with samples.

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
    """Encode the bins of one stream for the page.

    ::

        n         uint32
        index     uint16, of the stream in the page's request
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
    """Return the newest *most* bins."""
    if len(bins.numbers) <= most:
        return bins
    return Bins(bins.numbers[-most:], bins.low[-most:], bins.high[-most:])


DRAWN_CHANNELS = 8
"""Number of channels of a stream that are drawn together."""
MAX_ROWS_HZ = 500.0
"""Faster streams are stored as minimum and maximum of short spans."""
_BIN_S = 2.0 / MAX_ROWS_HZ


def key_of(number: int, first: int = 0) -> str:
    """Return the key by which a browser asks for channels of a stream, from the `first` on."""
    return f"{number}:{first}" if first else str(number)


def chosen(keys: Iterable[str]) -> dict[int, set[int]]:
    """Return the first channel of each window that browsers ask for, by the stream's number.

    Keys that `key_of` cannot have made are left out.
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
    """Return some channels of samples as float32, with NaN for values that are not finite.

    Parameters
    ----------
    times : shape (n,)
        Local LSL time.
    samples : shape (n, n_channels)
    rate
        Nominal rate in Hz, or the measured rate if that is higher.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        values = samples[:, first : first + DRAWN_CHANNELS].astype(np.float32)
    values[~np.isfinite(values)] = np.nan
    found = Samples(key, times, values)
    return _thinned(found) if rate > MAX_ROWS_HZ else found


def measured_rate(times: NDArray[np.float64]) -> float:
    """Return the rate of samples in Hz by their stamps; 0 for too few samples.

    The size of a chunk does not matter, because samples may have waited.
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
