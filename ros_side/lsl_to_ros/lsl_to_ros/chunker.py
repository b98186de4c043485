"""Collects samples into chunks of one length."""

from __future__ import annotations

from array import array
from collections.abc import Sequence


class Chunker:
    """Cuts a stream into chunks; no sample is dropped or repeated by a change of length.

    Parameters
    ----------
    channels
        Values in one sample.
    typecode
        Of the chunk's array: ``f``, ``d``, ``i`` or ``q``, as in :mod:`array`.

    """

    def __init__(self, channels: int, typecode: str) -> None:
        self._channels = channels
        self._values: array[float] = array(typecode)

    @property
    def pending(self) -> int:
        """Samples waiting for their chunk to be full."""
        return len(self._values) // self._channels

    def add(self, sample: Sequence[float], length: int) -> list[array[float]]:
        """Add one sample; return the chunks of *length* samples that are now full.

        More than one can be full after the length was reduced. Each is row-major,
        shape [length, channels].

        Raises
        ------
        TypeError, OverflowError
            If a value does not fit the array; nothing of the sample is then kept.
        """
        self._values.extend(array(self._values.typecode, sample))
        size = length * self._channels
        full: list[array[float]] = []
        while len(self._values) >= size:
            full.append(self._values[:size])
            del self._values[:size]
        return full

    def discard(self) -> int:
        """Give up a partial chunk, for a chunk never spans a gap; return its samples."""
        discarded = self.pending
        del self._values[:]
        return discarded
