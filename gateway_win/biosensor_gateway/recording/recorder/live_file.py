"""Monitors a recording while it is written: which streams arrive, and which have stopped."""

from __future__ import annotations

import math
import os
import shutil
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from biosensor_common.quantities import ChannelFormat
from biosensor_common.refusal import LATELY_S
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.device_states import clock_time, described, names
from biosensor_gateway.recording.participants import listed
from biosensor_gateway.recording.xdf.container import BOUNDARY, MAGIC, ChunkError, Frame, Tag
from biosensor_gateway.recording.xdf.counters import (
    NEAR_S,
    STRANGE_READINGS,
    STRANGE_SAMPLES,
    Reading,
    newest_of_each_kind,
    parse_readings,
)
from biosensor_gateway.recording.xdf.event_rules import (
    OF_ANOTHER_AGENT,
    EventLog,
    Spell,
    are_within,
    clock_set_text,
    split_pauses,
)
from biosensor_gateway.recording.xdf.figures import (
    MAX_STAMP_ERROR_S,
    MAX_UPTIME_S,
    Gap,
    Gaps,
    find_gaps,
    joined,
)
from biosensor_gateway.recording.xdf.findings import Finding, Level, other_participants
from biosensor_gateway.recording.xdf.header import RecordedHeader, parse_stream_header
from biosensor_gateway.recording.xdf.pace import Cuts
from biosensor_gateway.recording.xdf.samples import (
    Constants,
    decode,
    decode_clock_offset,
    flat_text,
)
from biosensor_gateway.recording.xdf.sender_clock import repeats

STOPPED_S = 5.0
STOPPED_PERIODS = 3
"""A slow stream counts as stopped when this many samples are missing."""
OFFSETS_DUE_S = 20.0
"""The recorder measures one every 5 s, and waits 2 s for each."""
BLOCK_BYTES = 8192
"""Size of the blocks in which the recorder writes its file."""
STILL_S, EMPTY_S = 15.0, 90.0
"""How long a fast file may stay unchanged, and how long a file may stay empty."""
LITTLE_SPACE_BYTES = 200_000_000

_STREAM_ID_BYTES = 4
# Length of the sections in which another program's stream is analysed.
_SECTION_S, _FEWEST = 20.0, 64
# LabRecorder writes chunks of half a second, so a larger chunk means a damaged length field.
MOST_CHUNK_BYTES = 1 << 26
_BLOCK_BYTES = 1 << 20
_LENGTH_SIZES = frozenset({1, 4, 8})
_TAG_BYTES = 2
_MOST_DAMAGES = 20
_MOST_TOLD, _MOST_CHUNKS = 64, 64
"""Counted timestamps that wait for samples, and chunks of samples to which they are compared."""
_MOST_SPELLS = 20
"""Number of absences of each sensor that are listed, the newest."""


GONE = "is no longer there: it was moved, renamed or deleted, or its disk was taken away"


class GrowingFile:
    """Passes on the chunks appended since the last call.

    Only an incomplete last chunk is kept in memory, until the rest is there.

    Parameters
    ----------
    take
        Called with tag and content of each chunk; raises `ChunkError` if these are invalid.
    """

    def __init__(self, path: Path, take: Callable[[Tag, memoryview], None]) -> None:
        self._path, self._take = path, take
        self._rest = b""
        self._has_begun = self._is_lost = False
        self.size = 0
        self.gone = ""  # What happened to it, as the end of a sentence; empty if nothing.
        # A clause for each unreadable place, in the order of the file.
        self.damages: list[str] = []

    def read_on(self) -> int:
        """Read what was appended; return its number of bytes.

        Raises
        ------
        OSError
            If the file exists but cannot be read.
        """
        before, self.gone = self.size, ""
        try:
            with self._path.open("rb") as file:
                if os.fstat(file.fileno()).st_size < self.size:
                    self.gone = "was shortened or replaced by another program"
                file.seek(self.size)
                while block := file.read(_BLOCK_BYTES):
                    self.size += len(block)
                    self._rest += block
                    self._walk()
        except FileNotFoundError:
            self.gone = GONE
            return 0
        return self.size - before

    def _walk(self) -> None:
        if not self._has_begun:
            if len(self._rest) < len(MAGIC):
                return  # nothing is dropped: it waits for more
            self._has_begun = True
            if self._rest.startswith(MAGIC):
                self._rest = self._rest[len(MAGIC) :]
            else:
                self._lose(0, "it does not start like a recording")
        position = self._find_again(0) if self._is_lost else 0
        while (end := self._next(position)) is not None:
            position = end
        self._rest = self._rest[position:]

    def _next(self, position: int) -> int | None:
        """Process the chunk at a buffer offset; return the next offset, None if incomplete."""
        if self._is_lost or position >= len(self._rest):
            return None  # nothing is dropped: it looks for the next chunk
        frame = _frame(self._rest, position)
        if frame is None:
            return None  # nothing is dropped: its head comes with the next read
        if not frame.is_known or frame.end - position > MOST_CHUNK_BYTES:
            return self._lose(position, "no chunk starts there")
        if frame.end > len(self._rest):
            return None  # nothing is dropped: the rest comes with the next read
        try:
            self._take(Tag(frame.tag), memoryview(self._rest)[frame.content_start : frame.end])
        except ChunkError as error:  # nothing is dropped: `_lose` reports it
            return self._lose(position, f"a {Tag(frame.tag).title} chunk: {error}")
        return frame.end

    def _lose(self, position: int, what: str) -> int:
        """Report damage once, and return the offset at which to continue."""
        if len(self.damages) < _MOST_DAMAGES:
            self.damages.append(f"byte {self.size - len(self._rest) + position}: {what}")
        self._is_lost = True
        return self._find_again(position)

    def _find_again(self, position: int) -> int:
        found = self._rest.find(BOUNDARY, position)
        if found < 0:
            # The end of the buffer may be the start of a boundary.
            return max(position, len(self._rest) - len(BOUNDARY) + 1)
        self._is_lost = False
        return found + len(BOUNDARY)


def _frame(buffer: bytes, position: int) -> Frame | None:
    """Read a frame; None if incomplete. An impossible frame gets an unknown tag."""
    length_size = buffer[position]
    if length_size not in _LENGTH_SIZES:
        return Frame(0, position, position)
    tag = position + 1 + length_size
    if tag + _TAG_BYTES > len(buffer):
        return None  # nothing is dropped: it waits for more
    length = int.from_bytes(buffer[position + 1 : tag], "little")
    if length < _TAG_BYTES:
        return Frame(0, position, position)
    kind = int.from_bytes(buffer[tag : tag + _TAG_BYTES], "little")
    return Frame(kind, tag + _TAG_BYTES, tag + length)


@dataclass(frozen=True, slots=True)
class StreamProgress:
    """Progress of one stream, as plain values."""

    name: str
    source_id: str
    host: str
    nominal_hz: float  # 0 if irregular.
    samples: int
    # Timestamp of its newest sample on its own clock, in s; None without samples.
    newest_stamp: float | None
    # Time from its newest sample to the newest one of any stream; None without samples.
    age_s: float | None
    clock_offsets: int
    # Time from the last offset to the newest sample of any stream; None without offsets.
    offset_age_s: float | None
    is_closed: bool  # Whether it has a footer.
    gaps: int = 0
    longest_gap_s: float = 0.0


class Counted:
    """Compares the timestamps of a stream with those in its agent's counters.

    A recorder may go on with another agent's stream of the same source_id, whose samples come at
    other times.
    """

    def __init__(self) -> None:
        # Time on the stream's clock from which its samples are not the counted ones; None if they
        # are.
        self.strange_since: float | None = None
        # nothing is dropped: these only tell whose the samples are
        self._told: deque[float] = deque(maxlen=_MOST_TOLD)
        # nothing is dropped: nor is anything of these
        self._came: deque[NDArray[np.float64]] = deque(maxlen=_MOST_CHUNKS)
        self._before = math.nan
        self._strange: list[float] = []

    def came(self, stamps: NDArray[np.float64]) -> None:
        """Take the timestamps of the next samples."""
        finite = stamps[np.isfinite(stamps)]
        if len(finite):
            self._came.append(finite)
            self._compare()

    def told(self, last_stamp: float) -> None:
        """Take the timestamp of the newest sample that the agent has counted."""
        newest = self._told[-1] if self._told else self._before
        if not last_stamp <= newest:
            self._told.append(last_stamp)
            self._compare()

    def _compare(self) -> None:
        while self._came and self._told and self._told[0] <= self._came[-1][-1]:
            stamp, before = self._told.popleft(), self._before
            self._before = stamp
            # What is not held any more, or was not recorded, tells nothing.
            is_known = self._came[0][0] <= before and self._nearest(stamp, before)[1]
            if is_known and self._nearest(stamp, before)[0] > NEAR_S:
                self._strange.append(stamp)
            else:
                self._strange.clear()
            if len(self._strange) >= STRANGE_READINGS and self.strange_since is None:
                self.strange_since = self._strange[0]

    def _nearest(self, stamp: float, since: float) -> tuple[float, bool]:
        """Return the distance of the nearest sample, and whether one came since a time."""
        off_s, has_come = math.inf, False
        for stamps in reversed(self._came):
            at = int(np.searchsorted(stamps, stamp))
            near = stamps[max(0, at - 1) : at + 1]
            off_s = min(off_s, float(np.abs(near - stamp).min()))
            has_come = has_come or (at > 0 and float(stamps[at - 1]) > since)
            if stamps[0] <= since:
                break
        return off_s, has_come


class _Losses:
    """Stores what the agent's counters report as lost or as not passed on unchanged.

    As in `biosensor_gateway.recording.xdf.counters.refusals`, what the first reading tells is about
    the time before the recording, unless it lasts.
    """

    def __init__(self) -> None:
        self.refused: list[str] = []  # The newest sentence of each kind.
        self.lost = 0  # Samples lost since the first reading.
        self._first: Reading | None = None
        self._count_before = self._readings = 0

    def told(self, reading: Reading) -> None:
        """Process the next reading; there is one per second."""
        if self._first is None:
            self._first = reading
            self._count_before = reading.lost
        # An agent that was restarted counts from 0 again.
        self.lost += max(0, reading.lost - self._count_before)
        self._count_before = reading.lost
        self._readings += 1
        lasts = self._readings > LATELY_S + 1
        new = [each for each in reading.refused if lasts or each not in self._first.refused]
        if new:
            self.refused = newest_of_each_kind([*self.refused, *new])


class _StreamReader:
    """Processes the chunks of one stream; times are on the recorder's clock, in s."""

    def __init__(self, header: RecordedHeader) -> None:
        self.header = header
        self.reached = -math.inf  # Current time according to this stream; -inf if unknown.
        # received_at, measured_at: the whole file's time when its newest samples and its newest
        # clock offset arrived; None before the first ones.
        self.received_at: float | None = None
        self.measured_at: float | None = None
        self.samples = self.offsets = 0
        self.is_repeated = False  # Whether the newest clock offset is the one before once more.
        self.gaps = Gaps()
        self.log = EventLog() if header.is_events else None
        self.counted = Counted()
        self.losses = _Losses()
        self.constants = Constants(header)
        self.is_closed = False
        self._last_stamp = math.nan
        self._offset = 0.0
        # Single timestamps of other programs are inexact, so gaps are found later, in sections.
        self._cuts: Cuts | None = None
        if header.is_regular and not header.has_exact_stamps:
            self._cuts = Cuts(header.rate, max(_FEWEST, math.ceil(_SECTION_S * header.rate)))

    @property
    def newest_stamp(self) -> float | None:
        """Newest timestamp on the stream's own clock; None without a valid one."""
        return self._last_stamp if math.isfinite(self._last_stamp) else None

    def take_samples(self, content: memoryview) -> tuple[str, ...]:
        """Process the content of a samples chunk; return its texts, empty for numbers.

        Raises
        ------
        ChunkError
            If it cannot be decoded; nothing is changed then.
        """
        before = self._last_stamp if self.samples else 0.0
        block = decode(content, self.header, before)
        stamps = block.stamps
        self.samples += len(stamps)
        if len(stamps):
            self._find_gaps(stamps)
            self._last_stamp = float(stamps[-1])
            self.counted.came(stamps)
            self.constants.add(block)
            if self._is_on_the_lsl_clock():
                self.reached = max(self.reached, self._last_stamp + self._offset)
        return block.texts

    def take_offset(self, content: memoryview) -> float | None:
        """Process the content of a clock offset chunk; return the recorder's time in it.

        None if it was not measured.

        Raises
        ------
        ChunkError
            If it is invalid.
        """
        measured = decode_clock_offset(content)
        if measured is None:
            return None  # nothing is dropped: an offset without a time is none
        taken_at, offset = measured
        self.is_repeated = self.offsets > 0 and repeats(self._offset, offset)
        self.offsets, self._offset = self.offsets + 1, offset
        # This is the true time, whatever the timestamps of samples say.
        self.reached = taken_at + self._offset
        return self.reached

    def _find_gaps(self, stamps: NDArray[np.float64]) -> None:
        if self._cuts is not None:
            self._cuts.take(stamps[np.isfinite(stamps)])
            holes = [Gap(each.after_s, each.length_s, each.lost) for each in self._cuts.holes]
            self.gaps = Gaps(len(holes), listed=tuple(holes))
            return  # nothing is dropped: the steps between runs are gaps as well
        run = np.concatenate(([self._last_stamp], stamps))
        self.gaps = joined(self.gaps, find_gaps([run], self.header))

    def _is_on_the_lsl_clock(self) -> bool:
        time = self._last_stamp + self._offset
        if self.offsets:
            # A stream on the LSL clock is not far ahead; a device with stored data may be far
            # behind.
            return time < self.reached + MAX_STAMP_ERROR_S
        made = self.header.created_at if math.isfinite(self.header.created_at) else 0.0
        return -MAX_STAMP_ERROR_S < self._last_stamp - made < MAX_UPTIME_S


@dataclass(frozen=True, slots=True)
class Progress:
    """The contents of a growing file, as plain values."""

    file: str
    bytes: int
    length_s: float  # From the first time in the file to the newest.
    still_s: float  # How long the file has not grown while it was monitored.
    free_bytes: int | None  # Free space on its disk; None if unknown.
    is_closed: bool  # Whether every recordable stream has a footer.
    streams: tuple[StreamProgress, ...]
    damages: tuple[str, ...]  # A clause for each unreadable place.


class Growth:
    """Reads a growing recording incrementally.

    Parameters
    ----------
    clock
        Any clock in s, to measure how long the file stays unchanged.
    began
        Unix time at which the recording began, by the clock as it is now, to find out at the first
        look for how long the file had not grown before; None if it is watched from its start.
    unix_time
        The clock of files.
    """

    def __init__(
        self,
        file: Path,
        clock: Callable[[], float] = time.monotonic,
        began: float | None = None,
        unix_time: Callable[[], float] = time.time,
    ) -> None:
        self._file, self._clock, self._began = file, clock, began
        self._unix_time = unix_time
        self._growing = GrowingFile(file, self._take)
        self._streams: dict[int, _StreamReader] = {}
        self._first: float | None = None
        self._newest: float | None = None
        self._has_data = False
        self._grew_at = clock()

    def look(self) -> Progress:
        """Read what was appended, and return the file's progress.

        Raises
        ------
        OSError
            If the file exists but cannot be read.
        """
        if self._growing.read_on():
            self._grew_at = self._clock() - self._rested_s()
        return Progress(
            file=str(self._file),
            bytes=self._growing.size,
            length_s=self._length_s,
            still_s=self._clock() - self._grew_at,
            free_bytes=_free_bytes(self._file),
            is_closed=self._is_closed,
            streams=tuple(self._progress(each) for each in self._streams.values()),
            damages=tuple(self._growing.damages),
        )

    def _rested_s(self) -> float:
        """Return for how long the file had not grown before the first look at it."""
        began, self._began = self._began, None
        if began is None:
            return 0.0
        now = self._unix_time()
        with suppress(OSError):
            # Either alone may be wrong: a file server has its own clock, and computers sleep.
            unchanged_s = now - self._file.stat().st_mtime
            # A file of the future is from before the clock was set back.
            known_s = unchanged_s if unchanged_s >= 0 else math.inf
            return max(0.0, min(known_s, now - began - self._length_s))
        return 0.0

    def problems(
        self, required: Collection[str] = (), silent: Collection[str] = frozenset()
    ) -> tuple[Finding, ...]:
        """Return the problems found so far, the worst first.

        Parameters
        ----------
        required
            source_ids of the streams that it must contain.
        silent
            source_ids of streams that may be silent, for example of a paused device.
        """
        streams = [self._progress(each) for each in self._streams.values()]
        identities = [each.header.identity for each in self._streams.values()]
        whose = other_participants(self._file, identities)
        found = [*self._problems_of_file(), *self._missing(required), *whose]
        if not self._is_closed:
            open_ones = [e for e in streams if not e.is_closed and e.source_id not in silent]
            for each in open_ones:
                found += self._stopped(each)
            found += self._unmeasured(open_ones)
            found += self._not_begun(open_ones)
        return tuple(sorted(found, key=lambda each: list(Level).index(each.level)))

    def story(self, source_id: str, own_started_s: float | None = None) -> Iterator[Finding]:
        """Yield the events so far: gaps, past absences, refusals, and another agent.

        Parameters
        ----------
        source_id, own_started_s
            As for `other_agents`.
        """
        yield from self.other_agents(source_id, own_started_s)
        yield from self.clock_set()
        yield from self.gone()
        yield from self.gaps()
        yield from self.was_away()
        yield from self.refused()
        yield from self.lost()

    def lost(self) -> Iterator[Finding]:
        """Yield losses that agents counted in streams without a gap."""
        for each in self._streams.values():
            lost = each.losses.lost
            if lost and not each.gaps.count:
                samples = "1 sample" if lost == 1 else f"{lost} samples"
                text = f"the agent has counted {samples} as lost on the way from the device"
                yield Finding(Level.WARNING, "lost", each.header.title, text)

    def refused(self) -> Iterator[Finding]:
        """Yield what agents refused, left out or doubted of recorded devices and streams."""
        # Two agents of one name say the same of one device.
        of_devices = dict.fromkeys(
            (device, each)
            for log in (each.log for each in self._streams.values() if each.log)
            for device, sentences in log.refused.items()
            for each in sentences
        )
        for device, each in of_devices:
            about = f"{device}: " if device else ""
            yield Finding(Level.WARNING, "refused", "", about + each)
        for stream in self._streams.values():
            for each in stream.losses.refused:
                yield Finding(Level.WARNING, "refused", stream.header.title, each)
            if flat := stream.constants.found:
                yield Finding(Level.WARNING, "flat", stream.header.title, flat_text(flat))

    @property
    def clock_steps_s(self) -> list[float]:
        """Sizes of the steps of the clocks of agents' computers."""
        return [each.by_s for _, log in self._of_agents for each in log.clock_steps]

    @property
    def _of_agents(self) -> list[tuple[RecordedHeader, EventLog]]:
        return [(each.header, each.log) for each in self._streams.values() if each.log]

    def clock_set(self) -> Iterator[Finding]:
        """Yield when the computers of agents slept, or their clocks were set."""
        for header, log in self._of_agents:
            for each in log.clock_steps:
                host = header.hostname or "the agent's computer"
                text = (
                    f"{host}: before {_clock_time(each.until_s, log)} {clock_set_text(each.by_s)}"
                )
                yield Finding(Level.WARNING, "clock-set", "", text)

    def gone(self) -> Iterator[Finding]:
        """Yield devices that their agent no longer has, as after a restart with other settings."""
        for log in (each.log for each in self._streams.values() if each.log):
            for device, since_s in log.gone.items():
                text = (
                    f"{described(device)} has not been among the agent's sensors since "
                    f"{_clock_time(since_s, log)}, and nothing of it is recorded; bring it back, "
                    "or stop and record again"
                )
                yield Finding(Level.ERROR, "removed", "", text)

    def gaps(self) -> Iterator[Finding]:
        """Yield the gaps of each device so far, from its stream with the longest ones."""
        worst: dict[str, tuple[Gaps, _StreamReader]] = {}
        for each in self._streams.values():
            header, gaps = each.header, self._gaps_of(each)
            device = header.name.rpartition("-")[0] if header.is_ours else header.title
            if gaps.count and not header.is_counters:
                found = gaps, each
                worst[device] = max(worst.get(device, found), found, key=lambda one: one[0].count)
        away = self._spells_over()
        for device, (gaps, stream) in worst.items():
            many = "1 gap" if gaps.count == 1 else f"{gaps.count} gaps"
            longest = "of" if gaps.count == 1 else "the longest of"
            text = f"{many} so far, {longest} {longest_s(gaps):.3g} s"
            spells = away.get(stream.header.identity, {}) if stream.header.identity else {}
            is_explained = len(spells) == 1 and are_within(gaps, list(spells.values()))
            part_of = next(iter(spells)) if is_explained else ""
            yield Finding(Level.WARNING, "gaps", device, text, part_of=part_of)

    def was_away(self) -> Iterator[Finding]:
        """Yield when devices were paused or not connected that are so no longer."""
        for spells in self._spells_over().values():
            for text in spells:
                yield Finding(Level.WARNING, "away", "", text)

    def _spells_over(self) -> dict[DeviceIdentity, dict[str, Spell]]:
        """Return the past absences of each device, by their sentences."""
        told = [
            (device, spell, log)
            for log in (each.log for each in self._streams.values() if each.log)
            for device, spells in log.spells_over.items()
            for spell in spells[-_MOST_SPELLS:]
        ]
        devices = list(dict.fromkeys(device for device, _, _ in told))
        name_of = dict(zip(devices, names(map(asdict, devices), "'s "), strict=True))
        found: dict[DeviceIdentity, dict[str, Spell]] = {device: {} for device in devices}
        for device, spell, log in told:
            found[device][f"{name_of[device]} was {_spell(spell, log)}"] = spell
        return found

    def other_agents(self, source_id: str, own_started_s: float | None) -> Iterator[Finding]:
        """Yield the start times of another agent's recorded streams with the same source_ids.

        Parameters
        ----------
        source_id
            Of the events of the agent of this computer.
        own_started_s
            When this agent began, in LSL s; None if there is none, or this is unknown.
        """
        for each in self._streams.values():
            if each.counted.strange_since is not None:
                text = f"{STRANGE_SAMPLES}; stop it and record again"
                yield Finding(Level.ERROR, "another-agent", each.header.title, text)
        logs = [(each.header, each.log) for each in self._streams.values() if each.log]
        for header, log in logs:
            own_s = own_started_s if header.source_id == source_id else None
            since_s = log.other_agent_since(own_s)
            if since_s is not None:
                text = (
                    f"from {_clock_time(since_s, log)} on {OF_ANOTHER_AGENT}; stop it and record "
                    "again"
                )
                yield Finding(Level.ERROR, "another-agent", header.title, text)

    @property
    def _length_s(self) -> float:
        return 0.0 if self._first is None or self._newest is None else self._newest - self._first

    @property
    def _is_closed(self) -> bool:
        due = [each for each in self._streams.values() if each.header.format != ChannelFormat.INT64]
        return bool(due) and all(each.is_closed for each in due)

    def _take(self, tag: Tag, content: memoryview) -> None:
        if tag in (Tag.FILE_HEADER, Tag.BOUNDARY):
            return  # nothing is dropped: they hold no samples
        if len(content) < _STREAM_ID_BYTES:
            raise ChunkError("it is too short")
        number = int.from_bytes(content[:_STREAM_ID_BYTES], "little")
        content = content[_STREAM_ID_BYTES:]
        if tag is Tag.STREAM_HEADER:
            self._streams.setdefault(number, _StreamReader(parse_stream_header(bytes(content))))
            return  # nothing is dropped: a header is taken
        stream = self._streams.get(number)
        if stream is None:
            raise ChunkError(f"stream number {number} has no header")
        # Headers of all streams precede the data.
        self._has_data = True
        if tag is Tag.STREAM_FOOTER:
            stream.is_closed = True
        elif tag is Tag.SAMPLES:
            texts = stream.take_samples(content)
            if stream.log is not None:
                stream.log.take(texts, self._recorded_beside(stream))
            if stream.header.is_counters:
                self._take_counters(texts)
            self._reach(stream)
            stream.received_at = self._newest
        else:
            self._take_offset(stream, content)

    def _take_counters(self, texts: Sequence[str]) -> None:
        by_source = {each.header.source_id: each for each in self._streams.values()}
        for source_id, readings in parse_readings(texts)[0].items():
            for each in readings if source_id in by_source else ():
                stream = by_source[source_id]
                stream.losses.told(each)
                if each.pushed:
                    stream.counted.told(each.last_stamp)

    def _take_offset(self, stream: _StreamReader, content: memoryview) -> None:
        before = stream.reached
        now = stream.take_offset(content)
        if now is None:
            return  # nothing is dropped: the first offset alone bounds nothing
        if before > now and before == self._newest:
            self._newest = max(each.reached for each in self._streams.values())
        self._reach(stream)
        if not stream.is_repeated:
            stream.measured_at = self._newest

    def _reach(self, stream: _StreamReader) -> None:
        """Advance the time of the whole file to that of a stream."""
        if not math.isfinite(stream.reached):
            return  # nothing is dropped: a stream without a sample has no time
        newest, first = self._newest, self._first
        if newest is None or first is None or self._is_first_true_time(stream.reached - newest):
            newest = first = stream.reached
            for each in self._streams.values():
                each.received_at = None if each.received_at is None else newest
        self._newest = max(stream.reached, newest)
        # The file's time moves back if earlier samples had a wrong time.
        self._first = min(self._newest, first)

    def _is_first_true_time(self, step_s: float) -> bool:
        """Whether all samples so far had been stored in their device."""
        return step_s > STOPPED_S and not any(each.offsets for each in self._streams.values())

    def _progress(self, stream: _StreamReader) -> StreamProgress:
        header = stream.header
        return StreamProgress(
            name=header.title,
            source_id=header.source_id,
            host=header.hostname,
            nominal_hz=header.rate,
            samples=stream.samples,
            newest_stamp=stream.newest_stamp,
            age_s=self._since(stream.received_at) if stream.samples else None,
            clock_offsets=stream.offsets,
            offset_age_s=self._since(stream.measured_at) if stream.offsets else None,
            is_closed=stream.is_closed,
            gaps=(gaps := self._gaps_of(stream)).count,
            longest_gap_s=longest_s(gaps),
        )

    def _gaps_of(self, stream: _StreamReader) -> Gaps:
        """Return the gaps of a stream, without those in which its device was paused."""
        device = stream.header.identity
        if device is None or not stream.gaps.count:
            return stream.gaps
        spells = [each for log in self._logs(stream) for each in log.spells.get(device, ())]
        return split_pauses(stream.gaps, spells)[0]

    def _logs(self, beside: _StreamReader) -> Iterator[EventLog]:
        """Yield the events of the agents on the computer of a stream."""
        for each in self._streams.values():
            if each.log is not None and each.header.hostname == beside.header.hostname:
                yield each.log

    def sources_of_agent(self, events: str) -> frozenset[str]:
        """Return the source_ids of the recorded streams of the agent that has these events."""
        headers = {each.header.source_id: each.header for each in self._streams.values()}
        host = headers[events].hostname if events in headers else None
        of_it = (each for each in headers.values() if each.is_of_agent and each.hostname == host)
        return frozenset(each.source_id for each in of_it) | {events}

    def _recorded_beside(self, events: _StreamReader) -> list[DeviceIdentity]:
        headers = (each.header for each in self._streams.values())
        host = events.header.hostname
        beside = (each.identity for each in headers if each.is_of_agent and each.hostname == host)
        return list(dict.fromkeys(filter(None, beside)))

    def _since(self, time_s: float | None) -> float:
        begun = self._first if time_s is None else time_s
        return 0.0 if self._newest is None or begun is None else max(0.0, self._newest - begun)

    def _problems_of_file(self) -> Iterator[Finding]:
        if self._growing.gone:
            text = (
                f"the file {self._growing.gone}, so what is recorded now may be lost: stop, look "
                "for it, and record again"
            )
            yield Finding(Level.ERROR, "file-gone", "", text)
        for damage in self._growing.damages:
            yield Finding(Level.ERROR, "damaged", "", f"the file is damaged at {damage}")
        free = _free_bytes(self._file)
        if free is not None and free < LITTLE_SPACE_BYTES and not self._is_closed:
            text = f"its disk has only {free / 1e6:.0f} MB left"
            yield Finding(Level.WARNING, "little-space", "", text)
        still_s = self._clock() - self._grew_at
        if not self._is_closed and still_s > self._longest_rest_s:
            text = (
                f"the file has not grown for {still_s:.0f} s: nothing is being recorded, or its "
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
            return  # nothing is dropped: no data may be due yet
        present = {each.header.source_id for each in self._streams.values()}
        for source_id in sorted(set(required) - present):
            text = "it is required and is not in the recording"
            yield Finding(Level.ERROR, "missing", source_id, text)

    def _stopped(self, stream: StreamProgress) -> Iterator[Finding]:
        age_s = self._age_s(stream)
        if self._has_stopped(stream):
            since = "since the recording started" if not stream.samples else f"for {age_s:.0f} s"
            text = f"none of its data was recorded {since}, while other streams continue"
            yield Finding(Level.ERROR, "stopped", stream.name, text)

    def _age_s(self, stream: StreamProgress) -> float:
        return self._length_s if stream.age_s is None else stream.age_s

    def _has_stopped(self, stream: StreamProgress) -> bool:
        return bool(stream.nominal_hz) and self._age_s(stream) > self._longest_age_s(stream)

    def _unmeasured(self, streams: Sequence[StreamProgress]) -> Iterator[Finding]:
        """Yield streams whose senders do not answer, once for each computer.

        If they come evenly, they go on nevertheless, or have stopped, which is told.
        """
        silent: dict[tuple[str, Level], dict[str, float]] = {}
        for each in streams:
            age_s = self._length_s if each.offset_age_s is None else each.offset_age_s
            if age_s > OFFSETS_DUE_S and not self._has_stopped(each):
                # A clock that was measured before is known, but for its drift since.
                is_known = each.clock_offsets or not each.nominal_hz
                level = Level.WARNING if is_known else Level.ERROR
                silent.setdefault((each.host, level), {})[each.name] = age_s
        for (_, level), ages_s in silent.items():
            names = list(ages_s)
            clocks, stream = "its clock has", names[0]
            if len(names) > 1:
                clocks, stream = f"the clocks of {listed(names)} have", ""
            text = (
                f"{clocks} not been measured for {max(ages_s.values()):.0f} s: the program has "
                "ended, or its answers do not arrive"
            )
            yield Finding(level, "no-offsets", stream, text)

    def _not_begun(self, streams: Sequence[StreamProgress]) -> Iterator[Finding]:
        """Yield regular streams without a sample yet, before they count as stopped."""
        due = [each for each in streams if each.nominal_hz and not each.samples]
        names = [each.name for each in due if self._length_s <= self._longest_age_s(each)]
        if names:
            text = f"nothing recorded yet from {listed(names)}"
            yield Finding(Level.WARNING, "not-begun", "", text)

    def _longest_age_s(self, stream: StreamProgress) -> float:
        periods_s = STOPPED_PERIODS / stream.nominal_hz if stream.nominal_hz else 0.0
        return max(STOPPED_S, periods_s)


def longest_s(gaps: Gaps) -> float:
    """Return the length of the longest gap in s; 0 without gaps."""
    return max((each.length_s for each in gaps.listed), default=0.0)


def _spell(spell: Spell, log: EventLog) -> str:
    since = "" if spell.since is None else f" from {_clock_time(spell.since, log)}"
    until = "" if spell.until is None else f" until {_clock_time(spell.until, log)}"
    return f"{spell.how}{since}{until}"


def _clock_time(lsl_s: float, log: EventLog) -> str:
    unix_s = log.unix_s(lsl_s)
    if unix_s is not None:
        # A damaged event may tell of a year that no calendar has.
        with suppress(OverflowError, OSError, ValueError):
            return clock_time(unix_s, seconds=True)
    return f"LSL time {lsl_s:.1f} s"


def _free_bytes(file: Path) -> int | None:
    try:
        return shutil.disk_usage(file.parent).free
    except OSError:  # nothing is dropped: the size of a disk
        return None  # nothing is dropped: the size of a disk
