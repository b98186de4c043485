"""Opens a recording."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from biosensor_gateway.recording.contents.stream import IndexedStream, Stream
from biosensor_gateway.recording.contents.wall_clock import WallClock, find_wall_clock
from biosensor_gateway.recording.xdf.container import Damage, open_recording, read_chunks
from biosensor_gateway.recording.xdf.recording import StreamSorter


@dataclass(frozen=True, slots=True)
class Contents:
    """An open recording.

    Attributes
    ----------
    begun
        The recorder's text for the start time; empty if there is none.
    streams
        In the order of their headers, including streams without samples.
    damages
        Bytes that could not be read.
    begin_s, end_s
        Times of the first and last sample on the recorder's LSL clock, in s; 0 without samples.
        Streams about the state of a device, which may be older than the recording, and streams on
        another clock count only if there are no others.
    wall
        Relation to the time of day; None if unknown.
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
        """What could not be read, as the end of a sentence about missing data."""
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
    """Open a recording and index it, which reads it once.

    Raises
    ------
    RecordingError
        If the file does not exist, cannot be read or is not an XDF file; also during reading.
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
    """Return the times of the first and last sample of some streams; 0 without samples.

    Times are on the recorder's clock, in s. Streams about the state of a device and streams on
    another clock count only if there are no others.
    """
    ends = [(_tells_when(each), found) for each in streams if (found := each.ends())]
    bounds = [found for tells_when, found in ends if tells_when] or [found for _, found in ends]
    if not bounds:
        return 0.0, 0.0
    return min(first for first, _ in bounds), max(last for _, last in bounds)


def _tells_when(stream: Stream) -> bool:
    return not (stream.header.may_be_older or stream.clock_error)
