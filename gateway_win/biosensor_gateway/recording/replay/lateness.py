"""Counts how much later than its stamp each sample was sent."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

BIN_S = 0.0001
_BINS = 100_000
# Folded together only now and then: a block has a sample or two.
_MOST_BLOCKS = 1024


class Lateness:
    """A histogram of 0.1 ms, so that hours of samples take no more memory than a second."""

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, np.int64)
        self._blocks: list[tuple[float, float, NDArray[np.float64]]] = []
        self._most_s = 0.0

    def add(self, sent_s: float, stamps: NDArray[np.float64], since_s: float = -math.inf) -> None:
        """Take in samples.

        Parameters
        ----------
        sent_s
            LSL time at which they had been given to LSL.
        stamps : ndarray of float64, shape (n_samples,)
        since_s
            What is stamped before that was late by intent, and is not counted.
        """
        self._blocks.append((sent_s, since_s, stamps))
        if len(self._blocks) >= _MOST_BLOCKS:
            self._fold()

    @property
    def most_s(self) -> float:
        """How late the latest sample was."""
        self._fold()
        return self._most_s

    def percentile_s(self, percent: float) -> float:
        """Return within which time so many of the samples were sent; 0 if there are none."""
        self._fold()
        sums: NDArray[np.int64] = np.cumsum(self._counts)
        if not sums[-1]:
            return 0.0
        wanted = int(sums[-1]) * percent / 100
        return (int(np.count_nonzero(sums < wanted)) + 1) * BIN_S

    def _fold(self) -> None:
        if not self._blocks:
            return
        sent, since, blocks = zip(*self._blocks, strict=True)
        lengths = [len(each) for each in blocks]
        stamps: NDArray[np.float64] = np.concatenate(blocks)
        late = (np.repeat(sent, lengths) - stamps)[stamps >= np.repeat(since, lengths)]
        self._blocks.clear()
        self._most_s = max(self._most_s, float(late.max(initial=0.0)))
        bins = np.clip(late / BIN_S, 0, _BINS - 1).astype(np.int64)
        np.add.at(self._counts, bins, 1)
