"""Cuts out of a stream what a browser draws: some channels, at a rate that a screen can show."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.page.downsampling import binned

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
