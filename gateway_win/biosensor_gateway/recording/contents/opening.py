"""Opens a recording."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from biosensor_gateway.recording.contents.stream import IndexedStream, Stream
from biosensor_gateway.recording.contents.wall_clock import WallClock, find_wall_clock
from biosensor_gateway.recording.xdf.container import Damage, open_recording, read_chunks
from biosensor_gateway.recording.xdf.sorting import StreamSorter


@dataclass(frozen=True, slots=True)
class Contents:
    """An open recording.

    Attributes
    ----------
    begun
        When, by the recorder's own words; empty if it does not say.
    streams
        In the order of their headers, also those without samples.
    damages
        What could not be read; everything else can.
    begin_s, end_s
        Times of the first and the last sample on the recorder's LSL clock, in s; 0 where there
        are none. What tells of a device may be older than the recording, and stamps may be on no
        LSL clock; such streams count only if there are no others.
    wall
        Time of day; None if nothing in the file tells it.
    """

    path: Path
    begun: str
    streams: tuple[Stream, ...]
    damages: tuple[Damage, ...]
    begin_s: float
    end_s: float
    wall: WallClock | None

    @property
    def why_incomplete(self) -> str:
        """What could not be read, as the end of a sentence that says what is not there."""
        if not self.damages:
            return ""
        first, *others = self.damages
        more = f" and {len(others)} more places" if others else ""
        return (
            f"; but byte {first.start}{more} cannot be read ({first.what}): "
            f"try biosensor-gateway xdf salvage {self.path}"
        )


@contextmanager
def open_contents(path: Path) -> Generator[Contents]:
    """Open a recording, and find out where everything in it is, which takes one pass.

    Raises
    ------
    RecordingError
        If there is no such file, it cannot be read, or it is no XDF file; also while it is
        being read.
    """
    sorter = StreamSorter(IndexedStream)
    with open_recording(path) as (file, size, is_unpacked_whole):
        damages = read_chunks(file, size, sorter.take)
        if not is_unpacked_whole:
            what = "the rest is compressed and cannot be unpacked"
            damages = (*damages, Damage(size, size, what, breaks_off=True))
        streams = tuple(Stream(file, number, each) for number, each in sorter.streams.items())
        begin_s, end_s = extent(streams)
        begun = sorter.begun or ""
        wall = find_wall_clock(streams, begun, begin_s, sorter.clock)
        yield Contents(path, begun, streams, damages, begin_s, end_s, wall)


def extent(streams: Sequence[Stream]) -> tuple[float, float]:
    """Return when the first and the last sample of some streams was recorded; 0 if there is none.

    On the recorder's clock, in s. What devices had told of themselves long before, and what is
    stamped on no LSL clock, counts only where there is nothing else.
    """
    ends = [(_tells_when(each), found) for each in streams if (found := each.ends())]
    bounds = [found for tells_when, found in ends if tells_when] or [found for _, found in ends]
    if not bounds:
        return 0.0, 0.0
    return min(first for first, _ in bounds), max(last for _, last in bounds)


def _tells_when(stream: Stream) -> bool:
    return not (stream.header.may_be_older or stream.clock_error)
