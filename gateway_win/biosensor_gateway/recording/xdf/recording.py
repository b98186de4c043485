"""Reads a recording: everything about its streams except the values themselves.

The file is read once, chunk by chunk. Kept in memory are the stamps (8 bytes a
sample) and the samples of the agent's counters; values are only searched for NaN.
"""

from __future__ import annotations

import math
import struct
from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.xdf.container import (
    BOUNDARY,
    Chunk,
    ChunkError,
    Damage,
    Tag,
    open_recording,
    read_chunks,
)
from biosensor_gateway.recording.xdf.header import (
    Footer,
    RecordedHeader,
    parse_file_header,
    parse_footer,
    parse_stream_header,
)
from biosensor_gateway.recording.xdf.samples import decode

_STREAM_ID_BYTES = 4
_CLOCK_OFFSET = struct.Struct("<dd")


@dataclass(slots=True)
class RecordedStream:
    """One stream of a recording.

    Attributes
    ----------
    nan_counts : ndarray of int64, shape (n_channels,)
        Samples without a value, by channel.
    clock_offsets
        LSL time on the stream's clock, and what to add to it to get the recorder's, in s.
    footer
        None if the recorder did not come to write it.
    texts
        Samples of the agent's counters, with their text; empty for all other streams.
    """

    header: RecordedHeader
    nan_counts: NDArray[np.int64]
    clock_offsets: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    footer: Footer | None = None
    texts: list[str] = field(default_factory=list[str])
    _stamps: array[float] = field(default_factory=lambda: array("d"))

    @property
    def stamps(self) -> NDArray[np.float64]:
        """LSL time of every sample on the stream's own clock, in the order of the file.

        A view, so nothing can be taken in while it is held.
        """
        return np.frombuffer(self._stamps, np.float64) if self._stamps else np.empty(0)

    @property
    def sample_count(self) -> int:
        """Number of samples in the file."""
        return len(self._stamps)

    def take_samples(self, content: memoryview) -> None:
        """Decode the samples of a chunk and take them in.

        Raises
        ------
        ChunkError
            If they cannot be decoded; none of them is taken in then.
        """
        last_stamp = self._stamps[-1] if self._stamps else 0.0
        block = decode(content, self.header, last_stamp)
        self._stamps.frombytes(block.stamps.tobytes())
        self.nan_counts += block.nan_counts
        if self.header.is_counters:
            self.texts.extend(block.texts)


@dataclass(frozen=True, slots=True)
class Recording:
    """What a file holds.

    Attributes
    ----------
    size
        Bytes, uncompressed.
    begun
        When, by the recorder's own words; empty if it does not say.
    streams
        In the order of their headers.
    damages
        What could not be read.
    orphans
        Number of chunks by stream number, of streams whose header is not readable.
    """

    path: Path
    size: int
    begun: str
    streams: tuple[RecordedStream, ...]
    damages: tuple[Damage, ...]
    orphans: Mapping[int, int]


def read_recording(path: Path) -> Recording:
    """Read everything of a recording that can be read.

    Raises
    ------
    RecordingError
        If there is no such file, it cannot be read, or it is no XDF file.
    """
    gathered = _Gathered()
    with open_recording(path) as (file, size, is_unpacked_whole):
        damages = read_chunks(file, size, gathered.take)
    if not is_unpacked_whole:
        what = "the rest is compressed and cannot be unpacked"
        damages = (*damages, Damage(size, size, what, breaks_off=True))
    streams = tuple(gathered.streams.values())
    return Recording(path, size, gathered.begun, streams, damages, gathered.orphans)


class _Gathered:
    """Takes the chunks of a file in and sorts them by stream."""

    def __init__(self) -> None:
        self.begun = ""
        self.streams: dict[int, RecordedStream] = {}
        self.orphans: Counter[int] = Counter()

    def take(self, chunk: Chunk) -> None:
        if chunk.tag is Tag.FILE_HEADER:
            self.begun = parse_file_header(chunk.content)
        elif chunk.tag is Tag.BOUNDARY:
            if chunk.content != BOUNDARY:
                raise ChunkError("it is not the one that every recording has")
        else:
            self._take_of_stream(chunk)

    def _take_of_stream(self, chunk: Chunk) -> None:
        if len(chunk.content) < _STREAM_ID_BYTES:
            raise ChunkError("it is too short")
        stream_id = int.from_bytes(chunk.content[:_STREAM_ID_BYTES], "little")
        content = memoryview(chunk.content)[_STREAM_ID_BYTES:]
        if chunk.tag is Tag.STREAM_HEADER:
            self._take_header(stream_id, bytes(content))
            return
        stream = self.streams.get(stream_id)
        if stream is None:
            self.orphans[stream_id] += 1
        elif chunk.tag is Tag.SAMPLES:
            stream.take_samples(content)
        elif chunk.tag is Tag.CLOCK_OFFSET:
            stream.clock_offsets.append(_clock_offset(content))
        else:
            stream.footer = parse_footer(bytes(content))

    def _take_header(self, stream_id: int, content: bytes) -> None:
        header = parse_stream_header(content)
        if stream_id in self.streams:
            raise ChunkError(f"it is the second of stream number {stream_id}")
        nan_counts = np.zeros(header.channel_count, np.int64)
        self.streams[stream_id] = RecordedStream(header, nan_counts)


def _clock_offset(content: memoryview) -> tuple[float, float]:
    if len(content) != _CLOCK_OFFSET.size:
        raise ChunkError("it does not have the size of a clock offset")
    taken_at, offset = _CLOCK_OFFSET.unpack(content)
    if not (math.isfinite(taken_at) and math.isfinite(offset)):
        raise ChunkError("its times are no numbers")
    return taken_at, offset
