"""Reads a damaged recording once, and determines what to keep of each stream.

Timestamps are not kept in memory, because files may be larger than the memory.
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

from biosensor_gateway.recording.xdf.chunks import samples
from biosensor_gateway.recording.xdf.container import (
    STREAM_ID_BYTES,
    Chunk,
    Damage,
    OpenRecording,
    RecordingError,
    RecordingReason,
    Tag,
    framed,
    read_chunks,
)
from biosensor_gateway.recording.xdf.figures import longest_step_s
from biosensor_gateway.recording.xdf.header import Footer, RecordedHeader
from biosensor_gateway.recording.xdf.pace import MOST_LOST, NO_PAUSE_S
from biosensor_gateway.recording.xdf.recording import NewHeader, StreamSorter
from biosensor_gateway.recording.xdf.samples import Block, decode
from biosensor_gateway.recording.xdf.sender_clock import is_reading

# With fewer samples, garbage cannot be recognised.
_FEWEST = 8


class Break(NamedTuple):
    """The effect of damage on a stream."""

    # first, end: range of the damages between the two samples, `end` excluded.
    first: int
    end: int
    # before, after: timestamps of the samples on either side, on the stream's clock; `before` is
    # NaN if there was none.
    before: float
    after: float
    is_gap: bool  # Whether samples are missing between them; always False for an irregular stream.


class Rewrite(NamedTuple):
    """A chunk that needs a stream number, or whose first sample needs a timestamp."""

    start: int
    end: int
    number: int
    stamp: float | None = None


class _Resumption(NamedTuple):
    """Samples after damage, up to the first one that has its own timestamp."""

    chunk: Chunk
    first_damage: int
    before: float
    unstamped: int


class Cut(NamedTuple):
    """A samples chunk whose last sample is removed, and the chunk that replaces it."""

    start: int
    end: int
    content: bytes


@dataclass(slots=True)
class KeptStream:
    """One stream of a damaged recording."""

    header: RecordedHeader
    sample_count: int = 0
    # first, last: timestamps of the first and last sample, 0 without samples.
    first: float = 0.0
    last: float = 0.0
    lost: int = 0  # Estimated number of samples lost in the damage.
    # Number of samples after damage whose time is unknown, because no timestamp follows.
    untimed: int = 0
    repeated: int = 0  # Number of samples in chunks that were written once more, and are removed.
    footer: Footer | None = None
    footer_at: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])
    breaks: list[Break] = field(default_factory=list[Break])
    restamps: list[Rewrite] = field(default_factory=list[Rewrite])
    # Set if the last sample is garbage, which an outlet that closes while recorded may leave.
    cut: Cut | None = None
    _newest: tuple[Chunk, tuple[float, ...]] | None = None
    _recent: tuple[float, ...] = ()
    _offsets: array[float] = field(default_factory=lambda: array("d"))
    _damages: int = 0
    _resumed: _Resumption | None = None

    @property
    def clock_offsets(self) -> list[tuple[float, float]]:
        """Pairs of LSL time on the stream's clock and offset to the recorder's clock, in s."""
        return list(zip(self._offsets[::2], self._offsets[1::2], strict=True))

    @property
    def offset_s(self) -> float:
        """Offset from a timestamp to the recorder's clock; 0 if never measured."""
        return next(filter(is_reading, self._offsets[1::2]), 0.0)

    @property
    def is_unclosed(self) -> bool:
        """Whether the recorder should have written a footer, and has not."""
        return self.header.lacks(self.footer, self.sample_count)

    @property
    def has_right_footer(self) -> bool:
        """Whether the count in its footer matches the kept samples."""
        counted = None if self.footer is None else self.footer.sample_count
        # Older LabRecorders forget the first sample.
        return self.footer is not None and (
            counted is None or self.sample_count - 1 <= counted <= self.sample_count
        )

    def take_samples(self, chunk: Chunk) -> None:
        """Decode the samples of a chunk and update the statistics."""
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
        """Add one of `clock_offsets`."""
        self._offsets.extend((taken_at, offset))

    def take_footer(self, footer: Footer, chunk: Chunk) -> None:
        """Set the footer; the last of several counts."""
        self.footer = footer
        self.footer_at.append((chunk.start, chunk.end))

    def end(self) -> None:
        """Finish: no more chunks follow."""
        self._forget_resumption()
        self._cut_garbage()

    def _cut_garbage(self) -> None:
        if self._newest is None or not self.header.is_regular or self.sample_count < _FEWEST:
            return
        chunk, recent = self._newest
        block = decode(chunk.body, self.header, recent[-1] if recent else 0.0)
        stamps = [*recent, *block.stamps[-3:-1].tolist()][-2:]
        # Cut only if the remaining samples end with a plausible timestamp.
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
        """Compute the timestamp of the first sample after damage, once a timestamp is known."""
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
            # Otherwise a loader would count periods from the sample before the damage.
            chunk = resumed.chunk
            self.restamps.append(Rewrite(chunk.start, chunk.end, chunk.stream_id, after))
            if not has_begun:
                self.first = after
        if math.isfinite(after):
            damages = (resumed.first_damage, self._damages)
            self.breaks.append(Break(*damages, resumed.before, after, is_gap))


# The readable rest of a damaged stream header: its number and its name.
_HEADER_REST = re.compile(
    rb"\x02\x00(.{%d})\s*<.{0,4096}?<name>([^<]{1,256})</name>" % STREAM_ID_BYTES, re.DOTALL
)
_SEARCHED_BYTES = 1 << 20


@dataclass(slots=True)
class Orphans:
    """Chunks of a stream whose header is lost; `name` is empty if it is unreadable."""

    name: str = ""
    chunks: int = 0
    bytes: int = 0


@dataclass(slots=True)
class Survey:
    """What can be read from a recording."""

    size: int
    # streams, orphans: by stream number.
    streams: dict[int, KeptStream]
    orphans: dict[int, Orphans]
    damages: tuple[Damage, ...]  # Bytes that cannot be read.
    has_file_header: bool
    # Headers that were fixed or taken from another recording, by stream number.
    new_headers: dict[int, NewHeader]
    renumbered: list[int]  # Numbers of the streams whose number in the file is another one's, too.
    # Places: start and end; of chunks that get another number, that as well.
    _dropped: array[int]
    _moved: array[int]

    @property
    def unclosed(self) -> list[int]:
        """Numbers of the streams whose footer is missing."""
        return [number for number, stream in self.streams.items() if stream.is_unclosed]

    @property
    def is_whole(self) -> bool:
        """Whether it has streams, and nothing needs to be fixed."""
        broken = self.damages or self.orphans or self.unclosed or self.new_headers
        broken = broken or self.renumbered
        broken = broken or any(each.cut or each.repeated for each in self.streams.values())
        return bool(self.streams) and not broken

    @property
    def sample_count(self) -> int:
        """Total number of samples."""
        return sum(stream.sample_count for stream in self.streams.values())

    def footers_due(self) -> list[int]:
        """Return the numbers of the streams whose footer is missing or wrong."""
        wrong = [
            number
            for number, stream in self.streams.items()
            if stream.footer is not None and not stream.has_right_footer
        ]
        return sorted([*self.unclosed, *wrong])

    def changes(self) -> Iterator[tuple[int, int, Rewrite | bytes | None]]:
        """Yield the parts not to copy, in the order of the file: start, end, replacement."""
        changes: list[tuple[int, int, Rewrite | bytes | None]] = [
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
        changed = {(start, end) for start, end, _ in changes}
        moved = map(Rewrite, self._moved[::3], self._moved[1::3], self._moved[2::3])
        changes += [(*each[:2], each) for each in moved if each[:2] not in changed]
        # Sorted by place only, so that a new header comes before the chunk at its place.
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
        Contents of headers missing in it, by stream number.

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
        self._moved = array("q")

    def take(self, chunk: Chunk) -> None:
        count = self._sorter.orphans.total()
        repeated = self._repeated
        taken = self._sorter.take(chunk)
        if self._sorter.orphans.total() > count:
            orphans = self._orphans.setdefault(chunk.stream_id, Orphans())
            orphans.chunks += 1
            orphans.bytes += chunk.end - chunk.start
            self._drop(chunk)
        elif self._repeated > repeated:
            self._drop(chunk)
        elif taken is not chunk:
            self._moved.extend((chunk.start, chunk.end, taken.stream_id))

    @property
    def _repeated(self) -> int:
        return sum(each.repeated for each in self._sorter.streams.values())

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
            self._sorter.renumbered,
            self._dropped,
            self._moved,
        )

    def _drop(self, chunk: Chunk) -> None:
        if self._dropped and self._dropped[-1] == chunk.start:
            self._dropped[-1] = chunk.end
        else:
            self._dropped.extend((chunk.start, chunk.end))


def _lost_headers(file: BinaryIO, damages: tuple[Damage, ...]) -> Iterator[tuple[int, str]]:
    """Find numbers and names in damaged headers."""
    for damage in damages:
        file.seek(damage.start)
        rest = file.read(min(damage.end - damage.start, _SEARCHED_BYTES))
        for found in _HEADER_REST.finditer(rest):
            number, name = found.groups()
            yield int.from_bytes(number, "little"), name.decode("utf-8", "replace")
