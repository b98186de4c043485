"""Finds the samples of each stream in a recording."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.xdf.container import (
    Chunk,
    ChunkError,
    RecordingError,
    RecordingReason,
)
from biosensor_gateway.recording.xdf.framing import STREAM_ID_BYTES
from biosensor_gateway.recording.xdf.header import Footer, RecordedHeader
from biosensor_gateway.recording.xdf.samples import Block, decode


class Place(NamedTuple):
    """Where one chunk of samples is, and what it takes to read it again.

    Attributes
    ----------
    start, end
        Offsets of its content in the file, without the stream's number, `end` excluded.
    before
        Stamp of the sample before it, from which stamps that were left out are counted.
    first, last
        Stamps of its first and last sample, on the stream's own clock, in s.
    offsets_before
        How many clock offsets of the stream come before it in the file.
    """

    start: int
    end: int
    before: float
    first: float
    last: float
    offsets_before: int


@dataclass(slots=True)
class IndexedStream:
    """One stream of a recording, with the places of its samples but without these.

    Attributes
    ----------
    clock_offsets
        LSL time on the stream's clock, and what to add to it to get the recorder's, in s.
    footer
        None if the recorder did not come to write it.
    guessed_texts
        How many are not UTF-8, so that their characters are guessed.
    """

    header: RecordedHeader
    clock_offsets: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    footer: Footer | None = None
    sample_count: int = 0
    guessed_texts: int = 0
    # Arrays, not a list of places: a day has millions of chunks.
    _bounds: array[int] = field(default_factory=lambda: array("q"))
    _stamps: array[float] = field(default_factory=lambda: array("d"))
    _last: float = 0.0

    def take_samples(self, chunk: Chunk) -> None:
        """Note where the samples of a chunk are.

        Raises
        ------
        ChunkError
            If they cannot be decoded.
        """
        block = decode(chunk.body, self.header, self._last)
        if not len(block.stamps):
            return
        first, last = float(block.stamps[0]), float(block.stamps[-1])
        start = chunk.end - len(chunk.content) + STREAM_ID_BYTES
        self._bounds.extend((start, chunk.end, len(self.clock_offsets)))
        self._stamps.extend((self._last, first, last))
        self._last = last
        self.sample_count += len(block.stamps)
        self.guessed_texts += block.guessed

    def take_clock_offset(self, taken_at: float, offset: float) -> None:
        """Take in one of `clock_offsets`."""
        self.clock_offsets.append((taken_at, offset))

    def take_footer(self, footer: Footer, _chunk: Chunk) -> None:
        """Take in the footer."""
        self.footer = footer

    @property
    def byte_count(self) -> int:
        """How many bytes of the file its samples take, with their stamps."""
        return sum(self._bounds[1::3]) - sum(self._bounds[0::3])

    def places(self) -> Iterator[Place]:
        """Give the places of all chunks of samples, in the order of the file."""
        bounds, stamps = self._bounds, self._stamps
        for at in range(0, len(bounds), 3):
            start, end, offsets_before = bounds[at : at + 3]
            before, first, last = stamps[at : at + 3]
            yield Place(start, end, before, first, last, offsets_before)

    def end_stamps(self) -> NDArray[np.float64]:
        """Return the stamps of first and last sample of all chunks, shape (n_chunks, 2), in s."""
        return np.array(self._stamps).reshape(-1, 3)[:, 1:]

    def read(self, file: BinaryIO, place: Place) -> Block:
        """Read the samples of one chunk again.

        Raises
        ------
        RecordingError
            If they are not there any more.
        """
        try:
            file.seek(place.start)
            content = file.read(place.end - place.start)
            return decode(memoryview(content), self.header, place.before)
        except (OSError, ChunkError) as error:
            message = f"the recording cannot be read any more at byte {place.start}: {error}"
            raise RecordingError(RecordingReason.UNREADABLE, message) from error
