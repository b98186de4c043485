"""Places the samples of one preset on the board's own clock, and counts those that are missing.

BrainFlow's stamps are the computer's time of day at arrival, so the board's clock is its count of
samples by its rate.
"""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

COUNTS_UP_TO = MappingProxyType(
    {
        ("SYNTHETIC_BOARD", 0): 256,
        ("SYNTHETIC_BOARD", 1): 256,
        ("CYTON_BOARD", 0): 256,
        ("GANGLION_BOARD", 0): 201,
    }
)
"""Where a board's packet number begins anew, for presets in which it counts samples.

Of all others it counts something else, or BrainFlow counts itself: what is lost is not known.
"""


class SampleCount:
    """Follows the packet number of one preset; `turns_over_at` is 0 where it counts nothing."""

    def __init__(self, turns_over_at: int) -> None:
        self._turn = turns_over_at
        self._number: float | None = None
        self._count = -1

    def place(self, numbers: NDArray[np.float64]) -> tuple[NDArray[np.int64], int]:
        """Return the place of each sample since the start, and how many are missing before them.

        Parameters
        ----------
        numbers : array, shape (n_samples,)
            Packet numbers.
        """
        if not self._turn:
            steps = np.ones(len(numbers), np.int64)
        else:
            first = numbers[0] - 1 if self._number is None else self._number
            differences = np.diff(numbers, prepend=first)
            # A number that stays is one more sample all the same.
            steps = np.maximum(1, np.round(differences % self._turn)).astype(np.int64)
            self._number = float(numbers[-1])
        places = self._count + np.cumsum(steps)
        self._count = int(places[-1])
        return places, int(steps.sum()) - len(steps)
