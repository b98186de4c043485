"""Sorts the chunks of a recording by stream."""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Generic, NamedTuple, Protocol, TypeVar

from biosensor_gateway.recording.xdf.container import Chunk, ChunkError
from biosensor_gateway.recording.xdf.framing import BOUNDARY, Tag
from biosensor_gateway.recording.xdf.header import (
    FileClock,
    Footer,
    RecordedHeader,
    fix_stream_header,
    parse_file_clock,
    parse_file_header,
    parse_footer,
    parse_stream_header,
)

_CLOCK_OFFSET = struct.Struct("<dd")


class TakesChunks(Protocol):
    """One stream; on an invalid chunk its methods raise `ChunkError` and change nothing."""

    def take_samples(self, chunk: Chunk, /) -> None:
        """Add the samples of a chunk."""
        ...

    def take_clock_offset(self, taken_at: float, offset: float, /) -> None:
        """Add an LSL time on the stream's clock and its offset to the recorder's, in s."""
        ...

    def take_footer(self, footer: Footer, chunk: Chunk, /) -> None:
        """Set the footer."""
        ...


_StreamT = TypeVar("_StreamT", bound=TakesChunks)


class NewHeader(NamedTuple):
    """A replacement for a stream header chunk that is missing or malformed.

    Attributes
    ----------
    start, end
        Offsets of the bytes that it replaces; equal if the header is missing.
    content
        Content of the new chunk, without the stream's number.
    wrong
        What was wrong with the original; empty if there was none.
    """

    start: int
    end: int
    content: bytes
    wrong: tuple[str, ...] = ()


class StreamSorter(Generic[_StreamT]):
    """Passes the chunks of a file, in order, to their streams.

    Parameters
    ----------
    make
        Creates a stream from its header.
    fixes_headers
        Whether to read malformed headers, too.
    lost_headers
        Contents of headers missing in the file, by stream number.

    Attributes
    ----------
    begun
        The recorder's text for the start time; None if there was no file header.
    clock
        How the file's clock relates to Unix time; None for a recording not imported from a bag.
    streams
        By stream number, in the order of their headers.
    orphans
        By stream number, the number of chunks of streams whose header is not readable.
    new_headers
        By stream number.
    """

    def __init__(
        self,
        make: Callable[[RecordedHeader], _StreamT],
        *,
        fixes_headers: bool = False,
        lost_headers: Mapping[int, bytes] | None = None,
    ) -> None:
        self._make = make
        self._fixes_headers = fixes_headers
        self._lost_headers = lost_headers or {}
        self._headers: dict[int, bytes] = {}
        self.new_headers: dict[int, NewHeader] = {}
        self.begun: str | None = None
        self.clock: FileClock | None = None
        self.streams: dict[int, _StreamT] = {}
        self.orphans: Counter[int] = Counter()

    def take(self, chunk: Chunk) -> None:
        """Process one chunk.

        Raises
        ------
        ChunkError
            If its content is invalid; nothing of it is used then.
        """
        if chunk.tag is Tag.FILE_HEADER:
            self.begun = parse_file_header(chunk.content)
            self.clock = parse_file_clock(chunk.content)
        elif chunk.tag is Tag.BOUNDARY:
            if chunk.content != BOUNDARY:
                raise ChunkError("it is not the one that every recording has")
        elif chunk.tag is Tag.STREAM_HEADER:
            self._take_header(chunk)
        else:
            self._take_of_stream(chunk)

    def _take_header(self, chunk: Chunk) -> None:
        stream_id, content = chunk.stream_id, bytes(chunk.body)
        if self._headers.setdefault(stream_id, content) == content and stream_id in self.streams:
            return  # nothing is dropped: it says the same once more
        new: NewHeader | None = None
        try:
            header = parse_stream_header(content)
        except ChunkError:
            if not self._fixes_headers:
                raise
            content, wrong = fix_stream_header(content)
            header = parse_stream_header(content)
            new = NewHeader(chunk.start, chunk.end, content, wrong)
        if stream_id in self.streams:
            raise ChunkError(f"it is the second of stream number {stream_id}")
        self.streams[stream_id] = self._make(header)
        if new is not None:
            self.new_headers[stream_id] = new

    def _take_of_stream(self, chunk: Chunk) -> None:
        stream = self.streams.get(chunk.stream_id)
        if stream is None and chunk.stream_id in self._lost_headers:
            content = self._lost_headers[chunk.stream_id]
            stream = self._make(parse_stream_header(content))
            self.streams[chunk.stream_id] = stream
            self.new_headers[chunk.stream_id] = NewHeader(chunk.start, chunk.start, content)
        if stream is None:
            if chunk.is_found:
                # Without a known stream, these bytes are probably not a chunk.
                raise ChunkError("its stream is unknown")
            self.orphans[chunk.stream_id] += 1
        elif chunk.tag is Tag.SAMPLES:
            stream.take_samples(chunk)
        elif chunk.tag is Tag.CLOCK_OFFSET:
            taken_at, offset = _clock_offset(chunk.body)
            # LabRecorder writes zeros if the other computer does not answer at first.
            if taken_at:
                stream.take_clock_offset(taken_at, offset)
        else:
            stream.take_footer(parse_footer(bytes(chunk.body)), chunk)


def _clock_offset(content: memoryview) -> tuple[float, float]:
    if len(content) != _CLOCK_OFFSET.size:
        raise ChunkError("it does not have the size of a clock offset")
    taken_at, offset = _CLOCK_OFFSET.unpack(content)
    if not (math.isfinite(taken_at) and math.isfinite(offset)):
        raise ChunkError("its times are no numbers")
    return taken_at, offset
