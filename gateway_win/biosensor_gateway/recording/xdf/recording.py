"""Reads a recording: everything about its streams except their values.

The file is read once, chunk by chunk. Only the timestamps (8 bytes per sample) and the samples of
the agent's counters and events are kept in memory; values are only checked for NaN.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.xdf.container import Chunk, Damage, open_recording, read_chunks
from biosensor_gateway.recording.xdf.header import Footer, RecordedHeader
from biosensor_gateway.recording.xdf.samples import decode
from biosensor_gateway.recording.xdf.sender_clock import SenderClock
from biosensor_gateway.recording.xdf.sorting import StreamSorter


@dataclass(slots=True)
class RecordedStream:
    """One stream of a recording.

    Attributes
    ----------
    nan_counts : ndarray of int64, shape (n_channels,)
        Number of NaN samples of each channel.
    clock_offsets
        Pairs of LSL time on the stream's clock and the offset to the recorder's clock, in s.
    footer
        None if the recorder did not write one.
    texts
        Samples of the agent's counters and events and of a node's events; empty for all other
        streams.
    guessed_texts
        Number of texts that are not UTF-8, so their encoding was guessed.
    """

    header: RecordedHeader
    nan_counts: NDArray[np.int64]
    clock_offsets: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    footer: Footer | None = None
    texts: list[str] = field(default_factory=list[str])
    guessed_texts: int = 0
    _stamps: array[float] = field(default_factory=lambda: array("d"))
    # Number of samples before each clock offset, which assigns samples to clock runs.
    _before_offsets: array[int] = field(default_factory=lambda: array("q"))

    @property
    def stamps(self) -> NDArray[np.float64]:
        """LSL time of every sample on the stream's own clock, in the order of the file.

        This is a view, so no samples can be added while it is in use.
        """
        return np.frombuffer(self._stamps, np.float64) if self._stamps else np.empty(0)

    def times(self) -> NDArray[np.float64]:
        """Return the recorder's LSL time of every sample, in s."""
        clock = SenderClock(self.clock_offsets)
        bounds = [0, *self._before_offsets, self.sample_count]
        parts = [
            clock.to_recorder(self.stamps[begin:end], number)
            for number, (begin, end) in enumerate(pairwise(bounds))
        ]
        return np.concatenate(parts)

    @property
    def sample_count(self) -> int:
        """Number of samples in the file."""
        return len(self._stamps)

    @property
    def is_unclosed(self) -> bool:
        """Whether the recorder should have written a footer, and has not."""
        return self.footer is None and (self.header.is_recordable or self.sample_count > 0)

    def take_samples(self, chunk: Chunk) -> None:
        """Decode the samples of a chunk and add them.

        Raises
        ------
        ChunkError
            If they cannot be decoded; none of them is added then.
        """
        last_stamp = self._stamps[-1] if self._stamps else 0.0
        block = decode(chunk.body, self.header, last_stamp)
        self._stamps.frombytes(block.stamps.tobytes())
        self.nan_counts += block.nan_counts
        self.guessed_texts += block.guessed
        header = self.header
        if header.is_counters or header.is_events or header.is_events_of_node:
            self.texts.extend(block.texts)

    def take_clock_offset(self, taken_at: float, offset: float) -> None:
        """Add one of `clock_offsets`."""
        self.clock_offsets.append((taken_at, offset))
        self._before_offsets.append(self.sample_count)

    def take_footer(self, footer: Footer, _chunk: Chunk) -> None:
        """Set the footer."""
        self.footer = footer


@dataclass(frozen=True, slots=True)
class Recording:
    """The contents of a recording, without values.

    Attributes
    ----------
    size
        Uncompressed, in bytes.
    begun
        The recorder's text for the start time; empty if there is none.
    streams
        In the order of their headers.
    damages
        Bytes that could not be read.
    orphans
        By stream number, the number of chunks of streams whose header is not readable.
    """

    path: Path
    size: int
    begun: str
    streams: tuple[RecordedStream, ...]
    damages: tuple[Damage, ...]
    orphans: Mapping[int, int]


def read_recording(path: Path) -> Recording:
    """Read as much of a recording as possible.

    Raises
    ------
    RecordingError
        If the file does not exist, cannot be read or is not an XDF file.
    """
    sorter = StreamSorter(_new_stream)
    with open_recording(path) as (file, size, is_unpacked_whole):
        damages = read_chunks(file, size, sorter.take)
    if not is_unpacked_whole:
        what = "the rest is compressed and cannot be unpacked"
        damages = (*damages, Damage(size, size, what, breaks_off=True))
    streams = tuple(sorter.streams.values())
    return Recording(path, size, sorter.begun or "", streams, damages, sorter.orphans)


def _new_stream(header: RecordedHeader) -> RecordedStream:
    return RecordedStream(header, np.zeros(header.channel_count, np.int64))
