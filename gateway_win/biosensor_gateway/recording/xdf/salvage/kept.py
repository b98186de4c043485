"""Keeps what a salvage knows of one stream, without stamps: files may exceed the memory."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field
from typing import NamedTuple

from biosensor_gateway.recording.xdf.container import Chunk
from biosensor_gateway.recording.xdf.header import Footer, RecordedHeader
from biosensor_gateway.recording.xdf.measuring import longest_step_s
from biosensor_gateway.recording.xdf.pace import MOST_LOST, NO_PAUSE_S
from biosensor_gateway.recording.xdf.samples import Block, decode
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
    _newest: tuple[Chunk, float] | None = None
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
        self._newest = chunk, self.last
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
        chunk, before = self._newest
        block = decode(chunk.body, self.header, before)
        stamps = [before, *block.stamps[-2:-1].tolist()]
        if abs(self.last - stamps[-1]) <= NO_PAUSE_S:
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
