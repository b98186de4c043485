"""Watches a recording while it is written: which streams come, and which have stopped."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.recording.growing.file import GrowingFile
from biosensor_gateway.recording.growing.stream import GrowingStream, StreamProgress
from biosensor_gateway.recording.xdf.container import ChunkError, Tag
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.recording.xdf.header import parse_stream_header

STOPPED_S = 5.0
STOPPED_PERIODS = 3
"""Of a stream that is slower, so many samples must be missing."""
OFFSETS_DUE_S = 20.0
"""The recorder takes one every 5 s, and waits 2 s for each."""
BLOCK_BYTES = 8192
"""The recorder writes its file in blocks of so many."""
STILL_S, EMPTY_S = 15.0, 90.0
"""How long a file may rest, if it is filled quickly; and before anything is in it."""
LITTLE_SPACE_BYTES = 200_000_000

_STREAM_ID_BYTES = 4


@dataclass(frozen=True, slots=True)
class Sight:
    """What is in a growing file, as plain values.

    Attributes
    ----------
    length_s
        From the first time that the file tells to the newest.
    still_s
        How long the file has not grown, as far as it was watched.
    free_bytes
        Space left on its disk; None if that cannot be known.
    is_closed
        Whether the recorder has ended every stream that it can record.
    damages
        A sentence part for each place that could not be read.
    """

    file: str
    bytes: int
    length_s: float
    still_s: float
    free_bytes: int | None
    is_closed: bool
    streams: tuple[GrowingStream, ...]
    damages: tuple[str, ...]


class Growth:
    """Looks into a recording again and again, and reads only what is new.

    Parameters
    ----------
    file
        The recording, which need not exist yet.
    clock
        Any clock in s, for how long the file rests.
    """

    def __init__(self, file: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._file, self._clock = file, clock
        self._growing = GrowingFile(file, self._take)
        self._streams: dict[int, StreamProgress] = {}
        self._first: float | None = None
        self._newest: float | None = None
        self._has_data = False
        self._grew_at = clock()

    def look(self) -> Sight:
        """Read what was appended, and say how the file stands.

        Raises
        ------
        OSError
            If the file is there and cannot be read.
        """
        if self._growing.read_on():
            self._grew_at = self._clock()
        return Sight(
            file=str(self._file),
            bytes=self._growing.size,
            length_s=self._length_s,
            still_s=self._clock() - self._grew_at,
            free_bytes=_free_bytes(self._file),
            is_closed=self._is_closed,
            streams=tuple(self._sight(each) for each in self._streams.values()),
            damages=tuple(self._growing.damages),
        )

    def problems(
        self, required: Collection[str] = (), silent: Collection[str] = frozenset()
    ) -> tuple[Finding, ...]:
        """Say what is wrong by what was read so far, the worst first.

        Parameters
        ----------
        required
            source_ids of the streams that must be in it.
        silent
            Those that may say nothing, as of a device that is paused.
        """
        streams = [self._sight(each) for each in self._streams.values()]
        found = [*self._problems_of_file(), *self._missing(required)]
        if not self._is_closed:
            for each in streams:
                if not each.is_closed and each.source_id not in silent:
                    found += self._problems_of_stream(each)
        return tuple(sorted(found, key=lambda each: list(Level).index(each.level)))

    def gaps(self) -> Iterator[Finding]:
        """Say of each device how much is missing so far, by the stream that misses most."""
        worst: dict[str, StreamProgress] = {}
        for each in self._streams.values():
            header = each.header
            device = header.name.rpartition("-")[0] if header.is_ours else header.name
            if each.gaps and not header.is_counters:
                worst[device] = max(worst.get(device, each), each, key=lambda one: one.gaps)
        for device, stream in worst.items():
            many = "1 gap" if stream.gaps == 1 else f"{stream.gaps} gaps"
            longest = "of" if stream.gaps == 1 else "the longest of"
            text = f"{many} so far, {longest} {stream.longest_gap_s:.3g} s"
            yield Finding(Level.WARNING, "gaps", device, text)

    @property
    def _length_s(self) -> float:
        return 0.0 if self._first is None or self._newest is None else self._newest - self._first

    @property
    def _is_closed(self) -> bool:
        due = [each for each in self._streams.values() if each.header.format != ChannelFormat.INT64]
        return bool(due) and all(each.is_closed for each in due)

    def _take(self, tag: Tag, content: memoryview) -> None:
        if tag in (Tag.FILE_HEADER, Tag.BOUNDARY):
            return
        if len(content) < _STREAM_ID_BYTES:
            raise ChunkError("it is too short")
        number = int.from_bytes(content[:_STREAM_ID_BYTES], "little")
        content = content[_STREAM_ID_BYTES:]
        if tag is Tag.STREAM_HEADER:
            self._streams.setdefault(number, StreamProgress(parse_stream_header(bytes(content))))
            return
        stream = self._streams.get(number)
        if stream is None:
            raise ChunkError(f"stream number {number} has no header")
        # All headers come before.
        self._has_data = True
        if tag is Tag.STREAM_FOOTER:
            stream.is_closed = True
        elif tag is Tag.SAMPLES:
            stream.take_samples(content)
            self._reach(stream)
            stream.heard_at = self._newest
        else:
            self._take_offset(stream, content)

    def _take_offset(self, stream: StreamProgress, content: memoryview) -> None:
        before = stream.reached
        now = stream.take_offset(content)
        if now is None:
            return
        if before > now and before == self._newest:
            self._newest = max(each.reached for each in self._streams.values())
        self._reach(stream)
        stream.measured_at = self._newest

    def _reach(self, stream: StreamProgress) -> None:
        """Let the time of the whole file go on to where a stream has come."""
        if not math.isfinite(stream.reached):
            return
        newest, first = self._newest, self._first
        if newest is None or first is None or self._is_first_true_time(stream.reached - newest):
            newest = first = stream.reached
            for each in self._streams.values():
                each.heard_at = None if each.heard_at is None else newest
        self._newest = max(stream.reached, newest)
        # It was set back where samples had said a time that it was not.
        self._first = min(self._newest, first)

    def _is_first_true_time(self, step_s: float) -> bool:
        """Whether all before were samples that had waited in their device."""
        return step_s > STOPPED_S and not any(each.offsets for each in self._streams.values())

    def _sight(self, stream: StreamProgress) -> GrowingStream:
        header = stream.header
        return GrowingStream(
            name=header.name,
            source_id=header.source_id,
            host=header.hostname,
            nominal_hz=header.rate,
            samples=stream.samples,
            newest_stamp=stream.newest_stamp,
            age_s=self._since(stream.heard_at) if stream.samples else None,
            clock_offsets=stream.offsets,
            offset_age_s=self._since(stream.measured_at) if stream.offsets else None,
            is_closed=stream.is_closed,
            gaps=stream.gaps,
            longest_gap_s=stream.longest_gap_s,
        )

    def _since(self, time_s: float | None) -> float:
        begun = self._first if time_s is None else time_s
        return 0.0 if self._newest is None or begun is None else max(0.0, self._newest - begun)

    def _problems_of_file(self) -> Iterator[Finding]:
        for damage in self._growing.damages:
            yield Finding(Level.ERROR, "damaged", "", f"the file is damaged at {damage}")
        free = _free_bytes(self._file)
        if free is not None and free < LITTLE_SPACE_BYTES and not self._is_closed:
            text = f"its disk has only {free / 1e6:.0f} MB left"
            yield Finding(Level.WARNING, "little-space", "", text)
        still_s = self._clock() - self._grew_at
        if not self._is_closed and still_s > self._longest_rest_s:
            text = (
                f"the file has not grown for {still_s:.0f} s: nothing is recorded any more, or its "
                "disk is full"
            )
            yield Finding(Level.ERROR, "still", "", text)

    @property
    def _longest_rest_s(self) -> float:
        if not self._length_s:
            return EMPTY_S
        return max(STILL_S, 3 * BLOCK_BYTES * self._length_s / self._growing.size)

    def _missing(self, required: Collection[str]) -> Iterator[Finding]:
        if not self._has_data:
            return
        present = {each.header.source_id for each in self._streams.values()}
        for source_id in sorted(set(required) - present):
            text = "it is required and is not in the recording"
            yield Finding(Level.ERROR, "missing", source_id, text)

    def _problems_of_stream(self, stream: GrowingStream) -> Iterator[Finding]:
        limit_s = self._longest_age_s(stream)
        age_s = self._length_s if stream.age_s is None else stream.age_s
        if stream.nominal_hz and age_s > limit_s:
            since = "since the recording began" if not stream.samples else f"for {age_s:.0f} s"
            text = f"nothing of it was recorded {since}, while others go on"
            yield Finding(Level.ERROR, "stopped", stream.name, text)
            return
        unmeasured_s = self._length_s if stream.offset_age_s is None else stream.offset_age_s
        if unmeasured_s > OFFSETS_DUE_S:
            text = (
                f"its clock has not been measured for {unmeasured_s:.0f} s: its program is gone, "
                "or its answers do not come through"
            )
            yield Finding(Level.ERROR, "no-offsets", stream.name, text)

    def _longest_age_s(self, stream: GrowingStream) -> float:
        periods_s = STOPPED_PERIODS / stream.nominal_hz if stream.nominal_hz else 0.0
        return max(STOPPED_S, periods_s)


def _free_bytes(file: Path) -> int | None:
    try:
        return shutil.disk_usage(file.parent).free
    except OSError:
        return None
