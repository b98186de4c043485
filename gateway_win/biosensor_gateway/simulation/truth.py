"""Records a virtual device's measurements, for comparison with received data."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Samples(NamedTuple):
    """Samples of one stream.

    Attributes
    ----------
    times : ndarray of float64, shape (n,)
        LSL time of measurement, without the device's drift.
    values : ndarray of float64, shape (n, channels)
        In declared units, with the precision of the sent format.
    """

    times: NDArray[np.float64]
    values: NDArray[np.float64]


class Truth:
    """The samples that a device has sent, by data name.

    Parameters
    ----------
    kept
        Maximum number of samples kept per stream; None for all, which is only for short tests.
    """

    def __init__(self, kept: int | None = None) -> None:
        self._kept = kept
        self._sent: dict[str, deque[tuple[float, tuple[float, ...]]]] = {}
        self._states: dict[str, Sequence[Sequence[float]]] = {}
        self._unsent: dict[str, int] = {}
        self._lock = Lock()

    def sent(
        self, data_name: str, times: Sequence[float], values: Sequence[Sequence[float]]
    ) -> None:
        """Record samples that were sent."""
        with self._lock:
            known = self._sent.setdefault(data_name, deque(maxlen=self._kept))
            known.extend((time, tuple(row)) for time, row in zip(times, values, strict=True))

    def told(
        self, data_name: str, times: Sequence[float], values: Sequence[Sequence[float]]
    ) -> None:
        """Record a sent state, if it has changed.

        Some devices repeat their state; only changes matter.
        """
        if values != self._states.get(data_name):
            self._states[data_name] = values
            self.sent(data_name, times, values)

    def unsent(self, data_name: str, count: int) -> None:
        """Count samples that were measured while streaming but not sent."""
        with self._lock:
            self._unsent[data_name] = self._unsent.get(data_name, 0) + count

    def samples(self, data_name: str) -> Samples:
        """Return the sent samples, oldest first."""
        with self._lock:
            rows = list(self._sent.get(data_name, ()))
        width = len(rows[0][1]) if rows else 0
        values = np.array([row for _, row in rows], np.float64).reshape(len(rows), width)
        return Samples(np.array([time for time, _ in rows], np.float64), values)

    def unsent_count(self, data_name: str) -> int:
        """Return the number of samples measured but never sent."""
        with self._lock:
            return self._unsent.get(data_name, 0)

    @property
    def data_names(self) -> tuple[str, ...]:
        """Data names of streams with any samples."""
        with self._lock:
            return tuple(self._sent)
