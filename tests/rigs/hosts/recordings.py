"""What a receiver got of its streams or topics, passed on as a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_FIELDS = ("arrivals", "stamps", "rows")


class Recording(NamedTuple):
    """Samples of one stream or topic in the order in which they came.

    Attributes
    ----------
    arrivals : ndarray of float64, shape (n,)
        Unix time at which each came, in seconds; all computers here share this clock.
    stamps : ndarray, shape (n,)
        Of a topic: header stamps in ns of Unix time, int64, 0 without a header. Of a
        stream: stamps on the sender's LSL clock in seconds, float64.
    rows : ndarray, shape (n, channels)
        Values, as float32 or text.
    """

    arrivals: NDArray[np.float64]
    stamps: NDArray[Any]
    rows: NDArray[Any]

    def between(self, start_s: float, end_s: float) -> Recording:
        """Return the samples that came from a time on and before another."""
        chosen = (self.arrivals >= start_s) & (self.arrivals < end_s)
        return Recording(self.arrivals[chosen], self.stamps[chosen], self.rows[chosen])


def save(path: Path, recordings: Mapping[str, Recording]) -> None:
    """Write recordings by name."""
    arrays = {
        f"{name}|{field}": array
        for name, recording in recordings.items()
        for field, array in zip(_FIELDS, recording, strict=True)
    }
    np.savez(path, allow_pickle=False, **arrays)


def load(path: Path) -> dict[str, Recording]:
    """Read what `save` wrote."""
    with np.load(path) as arrays:
        names = dict.fromkeys(key.rpartition("|")[0] for key in arrays.files)
        return {
            name: Recording(*(arrays[f"{name}|{field}"] for field in _FIELDS)) for name in names
        }
