"""Collects samples into chunks of one length."""

from __future__ import annotations


class Chunker:
    """Cuts a stream into chunks; no sample is dropped or repeated by a change of length.

    Parameters
    ----------
    sample_size
        Bytes of one sample.
    """

    def __init__(self, sample_size: int) -> None:
        self._sample_size = sample_size
        self._values = bytearray()

    @property
    def pending(self) -> int:
        """Samples waiting for their chunk to be full."""
        return len(self._values) // self._sample_size

    def add(self, values: bytes, length: int) -> list[bytes]:
        """Add whole samples; return the chunks of *length* samples that are now full.

        Several can be full, after many samples or when the length was reduced. Values
        stay as they come: row-major, shape [length, channels].
        """
        collected = self._values
        collected += values
        size = length * self._sample_size
        end = len(collected) - len(collected) % size
        if not end:
            # nothing is dropped: they wait for more
            return []
        full = [bytes(collected[start : start + size]) for start in range(0, end, size)]
        del collected[:end]
        return full

    def discard(self) -> int:
        """Give up a partial chunk, for a chunk never spans a gap; return its samples."""
        discarded = self.pending
        self._values.clear()
        return discarded
