"""Reads a damaged recording once, and says what of it is to be kept."""

from __future__ import annotations

import os
import re
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from biosensor_gateway.recording.xdf.container import (
    Chunk,
    Damage,
    OpenRecording,
    RecordingError,
    RecordingReason,
    read_chunks,
)
from biosensor_gateway.recording.xdf.framing import STREAM_ID_BYTES, Tag, framed
from biosensor_gateway.recording.xdf.salvage.kept import KeptStream, Restamp
from biosensor_gateway.recording.xdf.sorting import NewHeader, StreamSorter

# What is left of a stream's header: its number and its name.
_HEADER_REST = re.compile(
    rb"\x02\x00(.{%d})\s*<.{0,4096}?<name>([^<]{1,256})</name>" % STREAM_ID_BYTES, re.DOTALL
)
_SEARCHED_BYTES = 1 << 20


@dataclass(slots=True)
class Orphans:
    """Chunks of a stream whose header is lost; `name` is empty if it cannot be read any more."""

    name: str = ""
    chunks: int = 0
    bytes: int = 0


@dataclass(slots=True)
class Survey:
    """What can be read of a recording.

    Attributes
    ----------
    streams, orphans
        By their numbers.
    damages
        What cannot be read.
    new_headers
        Of streams whose header was fixed or taken from another recording, by their numbers.
    """

    size: int
    streams: dict[int, KeptStream]
    orphans: dict[int, Orphans]
    damages: tuple[Damage, ...]
    has_file_header: bool
    new_headers: dict[int, NewHeader]
    _dropped: array[int] = field(default_factory=lambda: array("q"))

    @property
    def unclosed(self) -> list[int]:
        """Numbers of the streams that should have a footer and have none."""
        return [number for number, stream in self.streams.items() if stream.is_unclosed]

    @property
    def is_whole(self) -> bool:
        """Whether it holds streams, and nothing is to be fixed."""
        broken = self.damages or self.orphans or self.unclosed or self.new_headers
        broken = broken or any(each.cut for each in self.streams.values())
        return bool(self.streams) and not broken

    @property
    def sample_count(self) -> int:
        """Samples of all streams."""
        return sum(stream.sample_count for stream in self.streams.values())

    def footers_due(self) -> list[int]:
        """Return the numbers of the streams that need a footer: a first one, or a right one."""
        wrong = [
            number
            for number, stream in self.streams.items()
            if stream.footer is not None and not stream.has_right_footer
        ]
        return sorted([*self.unclosed, *wrong])

    def changes(self) -> Iterator[tuple[int, int, Restamp | bytes | None]]:
        """Give, in the order of the file, what is not to be copied: begin, end, what instead."""
        changes: list[tuple[int, int, Restamp | bytes | None]] = [
            (each.start, each.end, framed(Tag.STREAM_HEADER, _numbered(number) + each.content))
            for number, each in self.new_headers.items()
        ]
        drops = list(zip(self._dropped[::2], self._dropped[1::2], strict=True))
        drops += [(damage.start, damage.end) for damage in self.damages]
        for number in self.footers_due():
            drops += self.streams[number].footer_at
        changes += [(start, end, None) for start, end in drops if end > start]
        for stream in self.streams.values():
            if stream.cut is not None:
                changes.append((stream.cut.start, stream.cut.end, stream.cut.content or None))
            cut_at = stream.cut and stream.cut.start
            changes += [
                (each.start, each.end, each) for each in stream.restamps if each.start != cut_at
            ]
        # A header stands before what it is put in front of.
        yield from sorted(changes, key=lambda change: change[:2])


def _numbered(number: int) -> bytes:
    return number.to_bytes(STREAM_ID_BYTES, "little")


def survey(
    path: Path, opened: OpenRecording, lost_headers: Mapping[int, bytes] | None = None
) -> Survey:
    """Read a recording.

    Parameters
    ----------
    lost_headers
        Contents of headers that are not in it, by the numbers of their streams.

    Raises
    ------
    RecordingError
        If it is still being written.
    """
    surveyor = _Surveyor(lost_headers)
    damages = read_chunks(opened.file, opened.size, surveyor.take)
    if not opened.is_unpacked_whole:
        what = "the rest is compressed and cannot be unpacked"
        damages = (*damages, Damage(opened.size, opened.size, what, breaks_off=True))
    if opened.file.seek(0, os.SEEK_END) != opened.size:
        message = f"{path} is still being written; end the recording first"
        raise RecordingError(RecordingReason.GROWS, message)
    return surveyor.end(opened, damages)


class _Surveyor:
    def __init__(self, lost_headers: Mapping[int, bytes] | None) -> None:
        self._sorter = StreamSorter(KeptStream, fixes_headers=True, lost_headers=lost_headers)
        self._orphans: dict[int, Orphans] = {}
        self._dropped = array("q")

    def take(self, chunk: Chunk) -> None:
        count = self._sorter.orphans.total()
        self._sorter.take(chunk)
        if self._sorter.orphans.total() > count:
            self._drop(chunk)

    def end(self, opened: OpenRecording, damages: tuple[Damage, ...]) -> Survey:
        streams = self._sorter.streams
        for stream in streams.values():
            stream.end()
        for number, name in _lost_headers(opened.file, damages):
            if number not in streams:
                self._orphans.setdefault(number, Orphans()).name = name
        has_file_header = self._sorter.begun is not None
        return Survey(
            opened.size,
            streams,
            self._orphans,
            damages,
            has_file_header,
            self._sorter.new_headers,
            self._dropped,
        )

    def _drop(self, chunk: Chunk) -> None:
        orphans = self._orphans.setdefault(chunk.stream_id, Orphans())
        orphans.chunks += 1
        orphans.bytes += chunk.end - chunk.start
        if self._dropped and self._dropped[-1] == chunk.start:
            self._dropped[-1] = chunk.end
        else:
            self._dropped.extend((chunk.start, chunk.end))


def _lost_headers(file: BinaryIO, damages: tuple[Damage, ...]) -> Iterator[tuple[int, str]]:
    """Find numbers and names in headers that cannot be read."""
    for damage in damages:
        file.seek(damage.start)
        rest = file.read(min(damage.end - damage.start, _SEARCHED_BYTES))
        for found in _HEADER_REST.finditer(rest):
            number, name = found.groups()
            yield int.from_bytes(number, "little"), name.decode("utf-8", "replace")
