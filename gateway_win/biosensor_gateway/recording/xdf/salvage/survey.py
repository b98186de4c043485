"""Reads a damaged recording once, and says what of each stream is to be kept.

No stamps are remembered: files may exceed the memory.
"""

from __future__ import annotations

import math
import os
import re
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from biosensor_gateway.recording.xdf.container import (
    Chunk,
    Damage,
    OpenRecording,
    RecordingError,
    RecordingReason,
    read_chunks,
)
from biosensor_gateway.recording.xdf.framing import STREAM_ID_BYTES, Tag, framed
from biosensor_gateway.recording.xdf.header import Footer, RecordedHeader
from biosensor_gateway.recording.xdf.measuring import longest_step_s
from biosensor_gateway.recording.xdf.pace import MOST_LOST, NO_PAUSE_S
from biosensor_gateway.recording.xdf.samples import Block, decode
from biosensor_gateway.recording.xdf.sorting import NewHeader, StreamSorter
from biosensor_gateway.recording.xdf.writing import samples

_FEWEST = 8
"""Of fewer samples nobody can say which is garbage."""


class Break(NamedTuple):
    """What a damage did to a stream.

    Attributes
    ----------
    first, end
        Numbers of the damages between the two samples, `end` excluded.
    before, after
        Stamps of the samples on either side, on the stream's clock; `before` is NaN if
        there was none.
    is_gap
        Whether samples are missing between them; never known of an irregular stream.
    """

    first: int
    end: int
    before: float
    after: float
    is_gap: bool


class Restamp(NamedTuple):
    """A samples chunk whose first sample is to get a stamp of its own."""

    start: int
    end: int
    stamp: float


class _Resumption(NamedTuple):
    """Samples behind a damage, as long as none of them has a stamp of its own."""

    chunk: Chunk
    first_damage: int
    before: float
    unstamped: int


class Cut(NamedTuple):
    """A samples chunk whose last sample is left out, and what stands in its place."""

    start: int
    end: int
    content: bytes


@dataclass(slots=True)
class KeptStream:
    """One stream of a damaged recording.

    Attributes
    ----------
    first, last
        Stamps of the first and the last sample, 0 without samples.
    lost
        Samples that would fit into the gaps at damages, an estimate.
    footer, footer_at
        What the recorder said, and where in the file.
    untimed
        Samples behind a damage whose stamps cannot be told, because none follows.
    cut
        Where the last sample is garbage, as an outlet leaves it that goes while it is recorded.
    """

    header: RecordedHeader
    sample_count: int = 0
    first: float = 0.0
    last: float = 0.0
    lost: int = 0
    untimed: int = 0
    footer: Footer | None = None
    footer_at: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])
    breaks: list[Break] = field(default_factory=list[Break])
    restamps: list[Restamp] = field(default_factory=list[Restamp])
    cut: Cut | None = None
    _newest: tuple[Chunk, tuple[float, ...]] | None = None
    _recent: tuple[float, ...] = ()
    _offsets: array[float] = field(default_factory=lambda: array("d"))
    _damages: int = 0
    _resumed: _Resumption | None = None

    @property
    def clock_offsets(self) -> list[tuple[float, float]]:
        """LSL time on the stream's clock, and what to add to it to get the recorder's, in s."""
        return list(zip(self._offsets[::2], self._offsets[1::2], strict=True))

    @property
    def offset_s(self) -> float:
        """What to add to a stamp to get the recorder's clock; 0 where it was never measured."""
        return self._offsets[1] if self._offsets else 0.0

    @property
    def is_unclosed(self) -> bool:
        """Whether the recorder should have written a footer, and has not."""
        return self.footer is None and (self.header.is_recordable or self.sample_count > 0)

    @property
    def has_right_footer(self) -> bool:
        """Whether its footer counts the samples that are kept."""
        counted = None if self.footer is None else self.footer.sample_count
        # Older LabRecorders forget the first sample.
        return self.footer is not None and (
            counted is None or self.sample_count - 1 <= counted <= self.sample_count
        )

    def take_samples(self, chunk: Chunk) -> None:
        """Decode the samples of a chunk, and keep what is to be known of them."""
        block = decode(chunk.body, self.header, self.last)
        if not len(block.stamps):
            return
        self._newest = chunk, self._recent
        if chunk.damages > self._damages:
            before = self.last if self.sample_count else math.nan
            self._forget_resumption()
            self._resumed = _Resumption(chunk, self._damages, before, 0)
            self._damages = chunk.damages
        if not self.sample_count:
            self.first = float(block.stamps[0])
        if self._resumed is not None:
            self._resume(block, self._resumed)
        self.sample_count += len(block.stamps)
        self.last = float(block.stamps[-1])
        self._recent = (*self._recent, *block.stamps[-2:].tolist())[-2:]

    def take_clock_offset(self, taken_at: float, offset: float) -> None:
        """Take in one of `clock_offsets`."""
        self._offsets.extend((taken_at, offset))

    def take_footer(self, footer: Footer, chunk: Chunk) -> None:
        """Take in a footer; of several, the last one counts."""
        self.footer = footer
        self.footer_at.append((chunk.start, chunk.end))

    def end(self) -> None:
        """Note that nothing follows."""
        self._forget_resumption()
        self._cut_garbage()

    def _cut_garbage(self) -> None:
        if self._newest is None or not self.header.is_regular or self.sample_count < _FEWEST:
            return
        chunk, recent = self._newest
        block = decode(chunk.body, self.header, recent[-1] if recent else 0.0)
        stamps = [*recent, *block.stamps[-3:-1].tolist()][-2:]
        # What stays is to end well: the one before may be garbage itself.
        ends_well = all(abs(each - stamps[-1]) <= NO_PAUSE_S for each in stamps)
        if not ends_well or abs(self.last - stamps[-1]) <= NO_PAUSE_S:
            return
        content = b""
        if len(block.stamps) > 1:
            form = self.header.format
            content = samples(chunk.stream_id, form, block.stamps[:-1], block.values[:-1])
        self.cut = Cut(chunk.start, chunk.end, content)
        self.sample_count -= 1
        self.last = stamps[-1]

    def _forget_resumption(self) -> None:
        if self._resumed is not None:
            self.untimed += self._resumed.unstamped
            self._resumed = None

    def _resume(self, block: Block, resumed: _Resumption) -> None:
        """Find the stamp of the first sample behind a damage, once a stamp is there."""
        unstamped = resumed.unstamped + block.unstamped
        if block.unstamped == len(block.stamps):
            self._resumed = resumed._replace(unstamped=unstamped)
            return
        self._resumed = None
        period = 1 / self.header.rate if self.header.is_regular else 0.0
        after = float(block.stamps[block.unstamped]) - unstamped * period
        step = after - resumed.before
        has_begun = not math.isnan(resumed.before)
        is_gap = math.isfinite(step) and step > longest_step_s(self.header)
        if is_gap:
            self.lost += round(min(step * self.header.rate, MOST_LOST)) - 1
        if unstamped and (is_gap or not has_begun):
            # A loader would count on from the sample before the damage.
            self.restamps.append(Restamp(resumed.chunk.start, resumed.chunk.end, after))
            if not has_begun:
                self.first = after
        if math.isfinite(after):
            damages = (resumed.first_damage, self._damages)
            self.breaks.append(Break(*damages, resumed.before, after, is_gap))


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
