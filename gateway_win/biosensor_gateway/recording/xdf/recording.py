"""Reads a recording: everything about its streams except their values.

The file is read once, chunk by chunk. The samples of the agent's counters and events are kept in
memory, and the timestamps (8 bytes per sample) in a temporary file if there are many; values are
only checked for NaN.
"""

from __future__ import annotations

import sys
import tempfile
import weakref
import zlib
from array import array
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count, pairwise
from pathlib import Path
from typing import BinaryIO, Generic, NamedTuple, Protocol, TypeVar

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
    FileClock,
    Footer,
    RecordedHeader,
    fix_stream_header,
    parse_file_clock,
    parse_file_header,
    parse_footer,
    parse_stream_header,
)
from biosensor_gateway.recording.xdf.rate_changes import Curve, RateChange
from biosensor_gateway.recording.xdf.samples import (
    STAMP_BYTES,
    Constants,
    decode,
    decode_clock_offset,
)
from biosensor_gateway.recording.xdf.sender_clock import (
    ASKED_EVERY_S,
    SenderClock,
    Silence,
    silences,
)

# Numbers of timestamps of one stream.
_MOST_IN_MEMORY = _BLOCK = 1 << 16
# Recorders count from 1, and a number that is given must not be that of a stream further down.
_FIRST_FREE = 100_001
# A chunk is compared with so many before it, in 30 s of a usual recorder.
_MOST_APART = 64


class TakesChunks(Protocol):
    """One stream; on an invalid chunk its methods raise `ChunkError` and change nothing.

    Attributes
    ----------
    repeated
        Number of samples in chunks that were written once more; these chunks are not taken.
    """

    header: RecordedHeader
    repeated: int

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
    """A replacement for a stream header chunk that is missing or malformed."""

    # start, end: offsets of the bytes that it replaces; equal if the header is missing.
    start: int
    end: int
    content: bytes  # Content of the new chunk, without the stream's number.
    wrong: tuple[str, ...] = ()  # What was wrong with the original; empty if there was none.


class StreamSorter(Generic[_StreamT]):
    """Passes the chunks of a file, in order, to their streams.

    A file may use one number for several streams, such as one that was joined from two recordings.
    What comes after another header is another stream, perhaps another person's, and gets a number
    of its own.

    Parameters
    ----------
    fixes_headers
        Whether to read malformed headers, too.
    lost_headers
        Contents of headers missing in the file, by stream number.
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
        # By number in the file: the newest header, and the number of its stream.
        self._headers: dict[int, bytes] = {}
        self._numbers: dict[int, int] = {}
        self._free = count(_FIRST_FREE)
        self.new_headers: dict[int, NewHeader] = {}  # By stream number.
        # The recorder's text for the start time; None if there was no file header.
        self.begun: str | None = None
        # How the file's clock relates to Unix time; None for a recording not imported from a bag.
        self.clock: FileClock | None = None
        self.streams: dict[int, _StreamT] = {}  # By stream number, in the order of their headers.
        # Numbers of the streams whose number in the file is another one's, too.
        self.renumbered: list[int] = []
        # By number in the file, the number of chunks of streams whose header is not readable.
        self.orphans: Counter[int] = Counter()
        # Likewise, where the first samples of those are that have no header, also no damaged one.
        self.headless: dict[int, tuple[int, int]] = {}
        self._unread: set[int] = set()
        # By stream number, length, check sum and first timestamp of its newest chunks of samples.
        self._newest: dict[int, deque[tuple[int, int, bytes]]] = {}

    def take(self, chunk: Chunk) -> Chunk:
        """Process one chunk, and return it with the number of its stream.

        Raises
        ------
        ChunkError
            If its content is invalid; nothing of it is used then.
        """
        if chunk.tag is Tag.FILE_HEADER:
            begun, clock = parse_file_header(chunk.content), parse_file_clock(chunk.content)
            # A second one belongs to a recording that was appended.
            if self.begun is None:
                self.begun, self.clock = begun, clock
        elif chunk.tag is Tag.BOUNDARY:
            if chunk.content != BOUNDARY:
                raise ChunkError("it is not the one that every recording has")
        elif chunk.tag is Tag.STREAM_HEADER:
            return self._take_header(chunk)
        else:
            return self._take_of_stream(chunk)
        return chunk

    def _take_header(self, chunk: Chunk) -> Chunk:
        told, content = chunk.stream_id, bytes(chunk.body)
        known = self._numbers.get(told)
        if known is not None and self._headers.get(told) == content:
            return chunk.of_stream(known)  # nothing is dropped: it says the same once more
        if not chunk.is_found:
            # Even if this header cannot be read, what follows is not of the stream before.
            self._numbers.pop(told, None)
            self._unread.add(told)
        original = content
        new: NewHeader | None = None
        try:
            header = parse_stream_header(content)
        except ChunkError:
            if not self._fixes_headers:
                raise
            content, wrong = fix_stream_header(content)
            header = parse_stream_header(content)
            new = NewHeader(chunk.start, chunk.end, content, wrong)
        self._headers[told] = original
        return chunk.of_stream(self._begin(told, header, new))

    def _begin(self, told: int, header: RecordedHeader, new: NewHeader | None) -> int:
        """Begin a stream, and return its number."""
        number = told
        if told in self.streams:
            number = next(each for each in self._free if each not in self.streams)
            self.renumbered.append(number)
        self._numbers[told] = number
        self.streams[number] = self._make(header)
        if new is not None:
            self.new_headers[number] = new
        return number

    def _take_of_stream(self, chunk: Chunk) -> Chunk:
        number = self._numbers.get(chunk.stream_id)
        if number is None and chunk.stream_id in self._lost_headers:
            content = self._lost_headers[chunk.stream_id]
            new = NewHeader(chunk.start, chunk.start, content)
            number = self._begin(chunk.stream_id, parse_stream_header(content), new)
        if number is None:
            if chunk.is_found:
                # Without a known stream, these bytes are probably not a chunk.
                raise ChunkError("its stream is unknown")
            self.orphans[chunk.stream_id] += 1
            if chunk.tag is Tag.SAMPLES and chunk.stream_id not in self._unread:
                self.headless.setdefault(chunk.stream_id, (chunk.start, chunk.end))
            return chunk
        stream, chunk = self.streams[number], chunk.of_stream(number)
        if chunk.tag is Tag.SAMPLES:
            if repeated := self._repeated(number, chunk, stream.header):
                stream.repeated += repeated
            else:
                stream.take_samples(chunk)
        elif chunk.tag is Tag.CLOCK_OFFSET:
            measured = decode_clock_offset(chunk.body)
            if measured is not None:
                stream.take_clock_offset(*measured)
        else:
            stream.take_footer(parse_footer(bytes(chunk.body)), chunk)
        return chunk

    def _repeated(self, number: int, chunk: Chunk, header: RecordedHeader) -> int:
        """Return the number of samples of a chunk if it is one of the newest once more, or 0.

        It must have a timestamp, and not all of its samples may be the same, as those of a sensor
        that lies on the table are while its sender's clock stands still.
        """
        body = chunk.body
        first = 1 + (body[0] if len(body) else 0)
        if len(body) <= first or body[first] != STAMP_BYTES:
            return 0
        stamp = bytes(body[first + 1 : first + 1 + STAMP_BYTES])
        key = len(body), zlib.crc32(body), stamp
        newest = self._newest.setdefault(number, deque(maxlen=_MOST_APART))
        if key not in newest:
            newest.append(key)
            return 0
        block = decode(body, header, 0.0)
        rows = [tuple(row) for row in block.values]
        is_one = all(row == rows[0] for row in rows) and block.stamps[0] == block.stamps[-1]
        return 0 if is_one else len(rows)


def repeated_text(count: int) -> str:
    """Return the sentence about samples in chunks that were written once more."""
    samples = "1 sample is" if count == 1 else f"{count} samples are"
    return f"{samples} in the file twice, each with its timestamp, and used once"


class _Stamps:
    """Timestamps in the order of the file; all but the last ones are in a temporary file."""

    def __init__(self) -> None:
        self._newest = array("d")
        self._earlier: BinaryIO | None = None
        self._stored = 0
        self._most = _MOST_IN_MEMORY
        self.last = 0.0

    def __len__(self) -> int:
        return self._stored + len(self._newest)

    def add(self, stamps: NDArray[np.float64]) -> None:
        if not len(stamps):
            return
        self.last = float(stamps[-1])
        self._newest.frombytes(stamps.tobytes())
        if len(self._newest) >= self._most:
            self._store()

    def _store(self) -> None:
        try:
            if self._earlier is None:
                self._earlier = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - kept open
                weakref.finalize(self, self._earlier.close)
            self._earlier.seek(self._stored * self._newest.itemsize)
            is_stored = self._earlier.write(self._newest) == memoryview(self._newest).nbytes
        except OSError:
            is_stored = False
        if not is_stored:
            # Without room on the disk, the rest stays in memory.
            self._most = sys.maxsize
            return
        self._stored += len(self._newest)
        self._newest = array("d")

    def read(self, begin: int, end: int) -> NDArray[np.float64]:
        """Return the timestamps from index `begin` to `end`."""
        parts: list[NDArray[np.float64]] = []
        if begin < self._stored and self._earlier is not None:
            self._earlier.seek(begin * self._newest.itemsize)
            size = (min(end, self._stored) - begin) * self._newest.itemsize
            parts.append(np.frombuffer(self._earlier.read(size), np.float64))
        if end > self._stored:
            newest = self._newest[max(0, begin - self._stored) : end - self._stored]
            parts.append(np.frombuffer(newest, np.float64))
        return np.concatenate([np.empty(0), *parts])


@dataclass(slots=True)
class RecordedStream:
    """One stream of a recording.

    Attributes
    ----------
    nan_counts : ndarray of int64, shape (n_channels,)
        Number of NaN or infinite samples of each channel.
    clock_offsets
        Pairs of LSL time on the stream's clock and the offset to the recorder's clock, in s.
    footer
        None if the recorder did not write one.
    texts
        Samples of the agent's counters and events and of a node's events; empty for all other
        streams.
    guessed_texts
        Number of texts that are not UTF-8, so their encoding was guessed.
    constants
        Channels that had one value for too long.
    """

    header: RecordedHeader
    nan_counts: NDArray[np.int64]
    clock_offsets: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    footer: Footer | None = None
    repeated: int = 0  # As of `TakesChunks`.
    texts: list[str] = field(default_factory=list[str])
    guessed_texts: int = 0
    _stamps: _Stamps = field(default_factory=_Stamps)
    constants: Constants = field(init=False)
    # Number of samples before each clock offset, which assigns samples to clock runs.
    _before_offsets: array[int] = field(default_factory=lambda: array("q"))

    def __post_init__(self) -> None:
        self.constants = Constants(self.header)

    @property
    def stamps(self) -> NDArray[np.float64]:
        """LSL time of every sample on the stream's own clock, in the order of the file."""
        return self._stamps.read(0, self.sample_count)

    def stamps_in_blocks(self) -> Iterator[NDArray[np.float64]]:
        """Yield `stamps` in parts, so that only one is in memory."""
        for begin in range(0, self.sample_count, _BLOCK):
            yield self._stamps.read(begin, min(begin + _BLOCK, self.sample_count))

    def times_in_blocks(self) -> Iterator[NDArray[np.float64]]:
        """Yield the recorder's LSL time of every sample in parts, in s."""
        clock = SenderClock(self.clock_offsets)
        bounds = [0, *self._before_offsets, self.sample_count]
        for number, (first, last) in enumerate(pairwise(bounds)):
            for begin in range(first, last, _BLOCK):
                stamps = self._stamps.read(begin, min(begin + _BLOCK, last))
                yield clock.to_recorder(stamps, number)

    def silences(self, end_s: float) -> list[Silence]:
        """Return when its sender neither answered the recorder nor sent anything.

        Parameters
        ----------
        end_s
            As for `sender_clock.silences`.
        """
        found = silences(self.clock_offsets, end_s)
        # It may send a while after one answer, and before another.
        edge_s = ASKED_EVERY_S + 1.0
        for times in self.times_in_blocks() if found else ():
            found = [
                each
                for each in found
                if not ((times > each.since_s + edge_s) & (times < each.until_s - edge_s)).any()
            ]
        return found

    @property
    def rate_changes(self) -> tuple[RateChange, ...]:
        """Permanent changes of its rate."""
        curve = Curve()
        for stamps in self.stamps_in_blocks() if self.header.is_regular else ():
            curve.add(stamps)
        return curve.changes(self.header, self._stamps.read)

    @property
    def sample_count(self) -> int:
        """Number of samples in the file."""
        return len(self._stamps)

    @property
    def is_unclosed(self) -> bool:
        """Whether the recorder should have written a footer, and has not."""
        return self.header.lacks(self.footer, self.sample_count)

    def take_samples(self, chunk: Chunk) -> None:
        """Decode the samples of a chunk and add them.

        Raises
        ------
        ChunkError
            If they cannot be decoded; none of them is added then.
        """
        block = decode(chunk.body, self.header, self._stamps.last)
        self._stamps.add(block.stamps)
        self.nan_counts += block.nan_counts
        self.constants.add(block)
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
    """The contents of a recording, without values."""

    path: Path
    size: int  # Uncompressed, in bytes.
    begun: str  # The recorder's text for the start time; empty if there is none.
    streams: tuple[RecordedStream, ...]  # In the order of their headers.
    renumbered: tuple[RecordedStream, ...]  # Those whose number in the file is another one's, too.
    damages: tuple[Damage, ...]  # Bytes that could not be read.
    # By number in the file, the number of chunks of streams whose header is not readable.
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
    renumbered = tuple(sorter.streams[number] for number in sorter.renumbered)
    return Recording(path, size, sorter.begun or "", streams, renumbered, damages, sorter.orphans)


def _new_stream(header: RecordedHeader) -> RecordedStream:
    return RecordedStream(header, np.zeros(header.channel_count, np.int64))
