"""Rewrites a recording without one person."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.runs import joined
from biosensor_gateway.recording.withdrawal.pieces import SAMPLES, Pieces
from biosensor_gateway.recording.withdrawal.traces import Person
from biosensor_gateway.recording.xdf import chunks
from biosensor_gateway.recording.xdf.container import (
    MAGIC,
    Chunk,
    ChunkError,
    Damage,
    Tag,
    framed,
    open_recording,
    read_chunks,
)
from biosensor_gateway.recording.xdf.header import (
    Footer,
    RecordedHeader,
    fix_stream_header,
    parse_stream_header,
)
from biosensor_gateway.recording.xdf.recording import StreamSorter
from biosensor_gateway.recording.xdf.samples import Texts, decode
from biosensor_gateway.system.new_file import new_file

_PIECES_OF_A_STREAM = 5


@dataclass(frozen=True, slots=True)
class Seen:
    """Traces of a person in a recording."""

    own: tuple[str, ...]  # Names of the person's streams.
    others: tuple[str, ...]  # Participants of the other streams.
    unnamed: int  # Number of streams without a participant, except the agent's and node's own.
    texts: tuple[str, ...]  # Names of the text streams that contain the person's name.
    damages: int


def look(path: Path, person: Person, pieces: Pieces) -> Seen:
    """Find a person in a recording, and collect pieces of their data.

    Raises
    ------
    RecordingError
        If it cannot be read.
    """
    with open_contents(path) as contents:
        own = [each for each in contents.streams if is_of(each.header, person)]
        rest = [each for each in contents.streams if not is_of(each.header, person)]
        for stream in own:
            _take_pieces(stream, pieces)
        people = {each.header.identity.participant for each in rest if each.header.identity} - {""}
        return Seen(
            tuple(each.header.title for each in own),
            tuple(sorted(people)),
            sum(each.header.identity is None for each in rest),
            tuple(each.header.title for each in rest if _names(each, person)),
            len(contents.damages),
        )


def participants(path: Path) -> set[str]:
    """Return who wore sensors of a recording.

    Raises
    ------
    RecordingError
        If it cannot be read.
    """
    with open_contents(path) as contents:
        known = (each.header.identity for each in contents.streams)
        return {each.participant for each in known if each is not None} - {""}


def take_pieces_of_all(path: Path, pieces: Pieces) -> None:
    """Collect pieces of all data of a recording that will be deleted."""
    with open_contents(path) as contents:
        for stream in contents.streams:
            _take_pieces(stream, pieces)


def is_of(header: RecordedHeader, person: Person) -> bool:
    """Whether a stream belongs to a person, by its header or else by its name."""
    if header.identity is not None and header.identity.participant:
        return person.is_called(header.identity.participant)
    return person.is_in_name(header.name) or person.is_in_name(header.source_id)


def _take_pieces(stream: Stream, pieces: Pieces) -> None:
    # A recorder may write each sample as a chunk.
    held: list[Samples] = []
    left = _PIECES_OF_A_STREAM
    for samples in stream.blocks():
        held.append(samples)
        if sum(map(len, held)) >= SAMPLES:
            pieces.take(joined(held))
            held, left = [], left - 1
        if not left:
            break


def is_named(path: Path, person: Person) -> bool:
    """Whether a recording's headers or texts name a person, or unreadable parts may do so.

    Raises
    ------
    RecordingError
        If nothing can be read.
    """
    with open_contents(path) as contents:
        is_unsure = any(_has_name(contents.path, each, person) for each in contents.damages)
        return is_unsure or any(_names(each, person) for each in contents.streams)


def _has_name(path: Path, damage: Damage, person: Person) -> bool:
    with open_recording(path) as opened:
        opened.file.seek(damage.start)
        return person.is_in_bytes(opened.file.read(damage.end - damage.start))


def _names(stream: Stream, person: Person) -> bool:
    if person.is_in(stream.header.xml):
        return True
    if stream.header.format is not ChannelFormat.STRING:
        return False
    return any(
        person.is_in(text)
        for samples in stream.blocks()
        if isinstance(samples.values, list)
        for row in samples.values
        for text in row
    )


def write_without(path: Path, target: Path, person: Person) -> None:
    """Copy a recording without a person's streams, and without their name in other texts.

    Unreadable parts are left out, because they could be the person's.

    Raises
    ------
    RecordingError
        If it cannot be read.
    OSError
        If it cannot be written.
    """
    with open_recording(path) as opened, new_file(target, like=path) as file:
        file.write(MAGIC)
        copy = _Copy(file, person)
        read_chunks(opened.file, opened.size, copy.take)


@dataclass(slots=True)
class _Kept:
    """A stream that is kept; counts what is written for its footer."""

    header: RecordedHeader
    clock_offsets: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    first: float = 0.0
    last: float = 0.0
    sample_count: int = 0
    repeated: int = 0
    read_last: float = 0.0

    def take_samples(self, chunk: Chunk) -> None:
        """See :class:`.TakesChunks`."""

    def take_clock_offset(self, taken_at: float, offset: float) -> None:
        """See :class:`.TakesChunks`."""
        self.clock_offsets.append((taken_at, offset))

    def take_footer(self, footer: Footer, chunk: Chunk) -> None:
        """See :class:`.TakesChunks`."""


class _Copy:
    def __init__(self, file: BinaryIO, person: Person) -> None:
        self._file, self._person = file, person
        self._sorter = StreamSorter(_Kept, fixes_headers=True)

    def take(self, chunk: Chunk) -> None:
        """Write one chunk, unchanged or without the person.

        Raises
        ------
        ChunkError
            If it cannot be read.
        """
        for part in self._parts(self._sorter.take(chunk)):
            self._file.write(part)

    def _parts(self, chunk: Chunk) -> Iterator[bytes]:
        if chunk.tag in (Tag.FILE_HEADER, Tag.BOUNDARY):
            yield framed(chunk.tag, chunk.content)
            return
        stream = self._sorter.streams.get(chunk.stream_id)
        if stream is None or is_of(stream.header, self._person):
            return
        is_text = stream.header.format is ChannelFormat.STRING
        if chunk.tag is Tag.STREAM_HEADER:
            yield self._header(chunk)
        elif chunk.tag is Tag.SAMPLES and is_text:
            yield from self._texts(chunk, stream)
        elif chunk.tag is Tag.STREAM_FOOTER and is_text:
            yield chunks.footer(chunk.stream_id, stream)
        else:
            yield framed(chunk.tag, chunk.content)

    def _header(self, chunk: Chunk) -> bytes:
        content = bytes(chunk.body)
        if not self._person.is_in_bytes(content):
            return framed(chunk.tag, chunk.content)
        try:
            header = parse_stream_header(content)
        except ChunkError:
            header = parse_stream_header(fix_stream_header(content)[0])
        return chunks.stream_header(chunk.stream_id, self._person.masked(header.xml))

    def _texts(self, chunk: Chunk, stream: _Kept) -> Iterator[bytes]:
        block = decode(chunk.body, stream.header, stream.read_last)
        if not len(block.stamps):
            return
        stream.read_last = float(block.stamps[-1])
        rows = block.values if isinstance(block.values, list) else []
        kept: Texts = []
        stamps: list[float] = []
        for stamp, row in zip(block.stamps.tolist(), rows, strict=True):
            texts = [without(text, self._person) for text in row]
            if any(text is None for text in texts):
                continue
            kept.append(tuple(text or "" for text in texts))
            stamps.append(stamp)
        if not kept:
            return
        stream.first = stream.first if stream.sample_count else stamps[0]
        stream.last = stamps[-1]
        stream.sample_count += len(kept)
        form = stream.header.format
        yield chunks.samples(chunk.stream_id, form, np.array(stamps), kept)


def without(text: str, person: Person) -> str | None:
    """Return a stream's text without a person; None if it is only about them."""
    if not person.is_in(text):
        return text
    try:
        content: object = json.loads(text)
    except (ValueError, RecursionError):
        return person.masked(text)
    if isinstance(content, str | int | float):
        return person.masked(text)
    pruned = person.pruned(content)
    return None if pruned is None else json.dumps(pruned, ensure_ascii=False)
