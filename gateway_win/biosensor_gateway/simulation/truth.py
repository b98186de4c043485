"""Records what a virtual device measured, for a test to compare with what arrived."""

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
        When each was measured, on the LSL clock, without the device's drift.
    values : ndarray of float64, shape (n, channels)
        In the units of the stream's declaration, as exact as the wire format allows.
    """

    times: NDArray[np.float64]
    values: NDArray[np.float64]


class Truth:
    """The samples that a device put on its link, by data name.

    Parameters
    ----------
    kept
        How many of the last samples of each stream are kept; None = all, which is
        for tests and not for days of running.
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
        """Note samples that the link took."""
        with self._lock:
            known = self._sent.setdefault(data_name, deque(maxlen=self._kept))
            known.extend((time, tuple(row)) for time, row in zip(times, values, strict=True))

    def told(
        self, data_name: str, times: Sequence[float], values: Sequence[Sequence[float]]
    ) -> None:
        """Note a state that the link took, if it is another one than before.

        Some devices tell theirs again and again; what there is to know is the change.
        """
        if values != self._states.get(data_name):
            self._states[data_name] = values
            self.sent(data_name, times, values)

    def unsent(self, data_name: str, count: int) -> None:
        """Note that so many samples were measured while streaming and could not be sent."""
        with self._lock:
            self._unsent[data_name] = self._unsent.get(data_name, 0) + count

    def samples(self, data_name: str) -> Samples:
        """Return what was sent, oldest first."""
        with self._lock:
            rows = list(self._sent.get(data_name, ()))
        width = len(rows[0][1]) if rows else 0
        values = np.array([row for _, row in rows], np.float64).reshape(len(rows), width)
        return Samples(np.array([time for time, _ in rows], np.float64), values)

    def unsent_count(self, data_name: str) -> int:
        """Return how many samples were measured and never sent."""
        with self._lock:
            return self._unsent.get(data_name, 0)

    @property
    def data_names(self) -> tuple[str, ...]:
        """Streams that sent anything."""
        with self._lock:
            return tuple(self._sent)
