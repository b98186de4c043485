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
    """One stream; what takes a chunk raises `ChunkError` if it makes no sense, and is as before."""

    def take_samples(self, chunk: Chunk, /) -> None:
        """Take in the samples of a chunk."""
        ...

    def take_clock_offset(self, taken_at: float, offset: float, /) -> None:
        """Take in LSL time on the stream's clock, and what to add to get the recorder's, in s."""
        ...

    def take_footer(self, footer: Footer, chunk: Chunk, /) -> None:
        """Take in what the recorder says at its end."""
        ...


_StreamT = TypeVar("_StreamT", bound=TakesChunks)


class NewHeader(NamedTuple):
    """A stream header chunk that a file lacks, or has in a wrong form.

    Attributes
    ----------
    start, end
        Bytes that it stands in place of; the same if there is none.
    content
        Of the new one, without the stream's number.
    wrong
        What was wrong with the one that was there; empty if there was none.
    """

    start: int
    end: int
    content: bytes
    wrong: tuple[str, ...] = ()


class StreamSorter(Generic[_StreamT]):
    """Takes the chunks of a file in, in their order, and hands them to their streams.

    Parameters
    ----------
    make
        Makes a stream of its header.
    fixes_headers
        Whether to read headers of a wrong form, too.
    lost_headers
        Contents of headers that are not in the file, by the numbers of their streams.

    Attributes
    ----------
    begun
        When, by the recorder's own words; None if there was no file header.
    clock
        Unix time by the file's clock; None of a recording that was not made of a bag.
    streams
        By their numbers, in the order of their headers.
    orphans
        Number of chunks by stream number, of streams whose header is not readable.
    new_headers
        By the numbers of their streams.
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
        """Take in one chunk.

        Raises
        ------
        ChunkError
            If its content makes no sense; nothing of it is taken in then.
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
                # Nothing else tells that these bytes are a chunk.
                raise ChunkError("its stream is unknown")
            self.orphans[chunk.stream_id] += 1
        elif chunk.tag is Tag.SAMPLES:
            stream.take_samples(chunk)
        elif chunk.tag is Tag.CLOCK_OFFSET:
            taken_at, offset = _clock_offset(chunk.body)
            # LabRecorder writes zeros if the other computer does not answer the first time.
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
