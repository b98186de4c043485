"""One stream of an open recording: the index of its samples, and access to them on one clock."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property, partial
from itertools import pairwise
from types import MappingProxyType
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_common.errors import SpecError
from biosensor_common.lsl_header import read_header
from biosensor_common.stream_header import CoreFields, StreamHeader, foreign_header
from biosensor_gateway.recording.xdf.container import (
    STREAM_ID_BYTES,
    Chunk,
    ChunkError,
    RecordingError,
    RecordingReason,
)
from biosensor_gateway.recording.xdf.figures import (
    Course,
    clock_bounds,
    clock_error,
    is_between,
    off_in_part,
    order_error,
)
from biosensor_gateway.recording.xdf.header import Footer, RecordedHeader
from biosensor_gateway.recording.xdf.pace import FEW_ASTRAY, STEP_BACK_S, without_stray
from biosensor_gateway.recording.xdf.rate_changes import MOST_CHANGES, Curve, RateChange
from biosensor_gateway.recording.xdf.samples import Block, Texts, decode
from biosensor_gateway.recording.xdf.sender_clock import SenderClock
from biosensor_gateway.recording.xdf.stream_rules import ODD_RATE

# A place with more jumps of its stamps has no single ones that are wrong.
_MOST_LEAPS = 200
_AROUND_LEAP = 64


class Place(NamedTuple):
    """The index entry of one chunk of samples."""

    # start, end: offsets of its content in the file, without the stream's number, `end` excluded.
    start: int
    end: int
    before: float  # Timestamp of the previous sample, from which omitted timestamps are computed.
    # first, last: timestamps of its first and last sample, on the stream's own clock, in s.
    first: float
    last: float
    offsets_before: int  # Number of clock offsets of the stream before it in the file.
    samples_before: int  # Number of its samples before it.


@dataclass(slots=True)
class IndexedStream:
    """One stream of a recording, with the index of its samples."""

    header: RecordedHeader
    # Pairs of LSL time on the stream's clock and offset to the recorder's clock, in s.
    clock_offsets: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    footer: Footer | None = None  # None if the recorder did not write one.
    sample_count: int = 0
    repeated: int = 0  # Number of samples in chunks that were written once more, and left out.
    guessed_texts: int = 0  # Number of texts that are not UTF-8, so their encoding was guessed.
    untimed: int = 0  # Number of samples with a NaN or infinite timestamp.
    # earliest, latest: range of the other timestamps.
    earliest: float = np.inf
    latest: float = -np.inf
    # Arrays instead of a list of places, because a day has millions of chunks.
    _bounds: array[int] = field(default_factory=lambda: array("q"))
    _stamps: array[float] = field(default_factory=lambda: array("d"))
    _leaps: array[int] = field(default_factory=lambda: array("q"))
    # Least and greatest timestamp of each chunk whose ends they are not, and its offsets_before.
    _within: array[float] = field(default_factory=lambda: array("d"))
    _last: float = 0.0
    _curve: Curve = field(default_factory=Curve)

    def take_samples(self, chunk: Chunk) -> None:
        """Add the samples of a chunk to the index.

        Raises
        ------
        ChunkError
            If they cannot be decoded.
        """
        block = decode(chunk.body, self.header, self._last)
        if not len(block.stamps):
            return
        first, last = float(block.stamps[0]), float(block.stamps[-1])
        start = chunk.end - len(chunk.content) + STREAM_ID_BYTES
        self._bounds.extend((start, chunk.end, len(self.clock_offsets), self.sample_count))
        self._stamps.extend((self._last, first, last))
        finite = block.stamps[np.isfinite(block.stamps)]
        if len(finite):
            low, high = float(finite.min()), float(finite.max())
            self.earliest, self.latest = min(low, self.earliest), max(high, self.latest)
            if not self.header.is_regular and (low < first or high > last):
                self._within.extend((low, high, len(self.clock_offsets)))
            if self.header.is_regular:
                self._curve.add(block.stamps)
                # Most chunks are shorter than a jump, and cost two comparisons.
                if abs(first - self._last) > STEP_BACK_S or high - low > STEP_BACK_S:
                    self._note_leap(finite)
        self._last = last
        self.sample_count += len(block.stamps)
        self.guessed_texts += block.guessed
        self.untimed += len(block.stamps) - len(finite)

    def _note_leap(self, stamps: NDArray[np.float64]) -> None:
        """Remember a chunk whose timestamps jump, within it or from the one before."""
        if len(self._leaps) > 2 * _MOST_LEAPS or self.header.has_exact_stamps:
            return
        far_s = max(STEP_BACK_S, 10.0 / self.header.rate)
        before = [self._last] if self.sample_count else []
        if np.abs(np.diff(np.concatenate([before, stamps]))).max(initial=0.0) > far_s:
            self._leaps.extend((self.sample_count, self.sample_count + len(stamps)))

    def stray(self, file: BinaryIO) -> dict[int, float]:
        """Return timestamps, by the number of the sample, in place of single ones far from all."""
        found: dict[int, float] = {}
        if not 0 < len(self._leaps) <= 2 * _MOST_LEAPS:
            return found
        for begin, end in zip(self._leaps[::2], self._leaps[1::2], strict=True):
            first = max(0, begin - _AROUND_LEAP)
            stamps = self.stamps(file, first, end + _AROUND_LEAP)
            replaced = without_stray(stamps, 1.0 / self.header.rate)
            found |= {
                number: stamp
                for at, stamp in replaced.items()
                # Not near the ends of what was read, where a stream seems to begin and to end.
                if begin - FEW_ASTRAY <= (number := first + at) < end + FEW_ASTRAY
            }
        return found

    def take_clock_offset(self, taken_at: float, offset: float) -> None:
        """Add one of `clock_offsets`."""
        self.clock_offsets.append((taken_at, offset))

    def take_footer(self, footer: Footer, _chunk: Chunk) -> None:
        """Set the footer."""
        self.footer = footer

    @property
    def byte_count(self) -> int:
        """Size of its samples and timestamps in the file, in bytes."""
        return sum(self._bounds[1::4]) - sum(self._bounds[0::4])

    def places(self) -> Iterator[Place]:
        """Yield the index entries of all chunks of samples, in the order of the file."""
        return map(self._place, range(len(self._bounds) // 4))

    def _place(self, at: int) -> Place:
        start, end, offsets_before, samples_before = self._bounds[4 * at : 4 * at + 4]
        before, first, last = self._stamps[3 * at : 3 * at + 3]
        return Place(start, end, before, first, last, offsets_before, samples_before)

    def part(self, begin: int, end: int, first: float, last: float) -> IndexedStream:
        """Return the index of the samples from `begin` to before `end`, with these timestamps."""
        is_in = self._has(begin, end)
        bounds = np.array(self._bounds).reshape(-1, 4)[is_in]
        stamps = np.array(self._stamps).reshape(-1, 3)[is_in]
        stamps[0, 1], stamps[-1, 2] = first, last
        return replace(
            self,
            sample_count=end - begin,
            _bounds=array("q", bounds.ravel().tolist()),
            _stamps=array("d", stamps.ravel().tolist()),
        )

    def rate_changes(self, file: BinaryIO) -> tuple[RateChange, ...]:
        """Return where its rate changes."""
        return self._curve.changes(self.header, partial(self.stamps, file))

    def stamps(self, file: BinaryIO, begin: int, end: int) -> NDArray[np.float64]:
        """Read the timestamps from index `begin` to before `end`."""
        some = [np.empty(0)]
        for place in map(self._place, np.flatnonzero(self._has(begin, end)).tolist()):
            at = place.samples_before
            some.append(self.read(file, place).stamps[max(0, begin - at) : end - at])
        return np.concatenate(some)

    def _has(self, begin: int, end: int) -> NDArray[np.bool_]:
        """Return which chunks have samples from index `begin` to before `end`."""
        firsts = np.array(self._bounds[3::4])
        behind = np.append(firsts[1:], self.sample_count)
        is_in: NDArray[np.bool_] = (behind > begin) & (firsts < end)
        return is_in

    @property
    def within(self) -> NDArray[np.float64]:
        """Extremes within chunks of a stream without a rate, with the offsets before them.

        Shape (n, 3); the first two are timestamps in s.
        """
        return np.array(self._within).reshape(-1, 3)

    def end_stamps(self, stray: Mapping[int, float] = MappingProxyType({})) -> NDArray[np.float64]:
        """Return the first and last timestamp of each chunk, shape (n_chunks, 2), in s.

        Parameters
        ----------
        stray
            Timestamps in place of recorded ones, by the number of the sample.
        """
        found = np.array(self._stamps).reshape(-1, 3)[:, 1:]
        if stray:
            firsts = np.array(self._bounds[3::4])
            for ends, numbers in ((0, firsts), (1, np.append(firsts[1:], self.sample_count) - 1)):
                is_stray = np.isin(numbers, list(stray))
                found[is_stray, ends] = [stray[at] for at in numbers[is_stray].tolist()]
        return found

    def read(self, file: BinaryIO, place: Place) -> Block:
        """Read the samples of one chunk.

        Raises
        ------
        RecordingError
            If they cannot be read any more.
        """
        try:
            file.seek(place.start)
            content = file.read(place.end - place.start)
            return decode(memoryview(content), self.header, place.before)
        except (OSError, ChunkError) as error:
            message = f"the recording can no longer be read at byte {place.start}: {error}"
            raise RecordingError(RecordingReason.UNREADABLE, message) from error


@dataclass(frozen=True, slots=True)
class Samples:
    """A block of samples of one stream, in the order of the file.

    Attributes
    ----------
    times : ndarray of float64, shape (n_samples,)
        LSL time on the recorder's clock, in s: timestamps with the clock offsets applied.
    stamps : ndarray of float64, shape (n_samples,)
        As recorded, on the stream's own clock.
    values : ndarray, shape (n_samples, n_channels), or list of tuple
        In the stream's own format; in text streams, one tuple per sample.
    """

    times: NDArray[np.float64]
    stamps: NDArray[np.float64]
    values: NDArray[Any] | Texts

    def __len__(self) -> int:
        return len(self.times)

    def picked(self, is_wanted: NDArray[np.bool_]) -> Samples:
        """Return the samples for which `is_wanted`, of shape (n_samples,), is true."""
        if is_wanted.all():
            return self
        values = self.values
        if isinstance(values, list):
            values = [each for each, wanted in zip(values, is_wanted, strict=True) if wanted]
        else:
            values = values[is_wanted]
        return Samples(self.times[is_wanted], self.stamps[is_wanted], values)


class Stream:
    """One stream of an open recording; use it only while the recording is open."""

    def __init__(self, file: BinaryIO, number: int, indexed: IndexedStream) -> None:
        self._file = file
        self._indexed = indexed
        self._span: tuple[int, int] | None = None  # Of a part: its first sample, and its end.
        self.number = number
        self.header: RecordedHeader = indexed.header  # As recorded.
        # Identity, labels, units and roles from the header; for another program's stream, as the
        # node interprets them.
        self.meaning: StreamHeader = _meaning(indexed.header)
        # Conversion between its clock and the recorder's.
        self.clock = SenderClock(indexed.clock_offsets)
        # Pairs of LSL time on the stream's clock and offset to the recorder's clock, in s, in the
        # order of the file.
        self.clock_offsets = tuple(indexed.clock_offsets)
        self.sample_count = indexed.sample_count  # Number of samples in the file.
        self.byte_count = indexed.byte_count  # Size of its samples and timestamps in the file.
        # Number of samples with a NaN or infinite timestamp; `blocks` leaves them out.
        self.untimed = indexed.untimed
        # Number of samples in chunks that were written once more; `blocks` leaves these out.
        self.repeated = indexed.repeated
        self.is_unclosed = indexed.header.lacks(indexed.footer, indexed.sample_count)
        # Whether its header or a text is not UTF-8, so the encoding was guessed.
        self.is_guessed = indexed.header.is_guessed or indexed.guessed_texts > 0

    @property
    def participant(self) -> str:
        """The recorded name of its participant; empty if unknown."""
        identity = self.header.identity
        return "" if identity is None else identity.participant

    def fits(self, pattern: str) -> bool:
        """Whether its name or source_id matches a pattern with ``*`` and ``?``."""
        return any(fnmatchcase(e, pattern) for e in (self.header.name, self.header.source_id))

    def take_wearer(self, participant: str) -> None:
        """Replace the participant in the header; no effect if the header names none."""
        identity = self.header.identity
        if identity is not None and identity.participant:
            worn = replace(identity, participant=participant)
            self.header = replace(self.header, identity=worn)
            self.meaning = replace(self.meaning, identity=worn)

    def with_rate(self, rate_hz: float) -> Stream:
        """Return a copy with this rate in its header."""
        other = copy(self)
        other.header = replace(self.header, rate=rate_hz)
        other.meaning = replace(self.meaning, rate=rate_hz)
        for cached in ("clock_error", "order_error", "part_error", "rate_changes", "_course"):
            other.__dict__.pop(cached, None)
        return other

    @cached_property
    def rate_changes(self) -> tuple[RateChange, ...]:
        """Permanent changes of its rate, as in `xdf check`."""
        return () if self.order_error else self._indexed.rate_changes(self._file)

    def parts(self, number: int) -> list[Stream]:
        """Return a stream for each of its rates; itself if its rate does not change.

        Parameters
        ----------
        number
            Of the second of them; the others follow.
        """
        changes = self.rate_changes
        if not 0 < len(changes) <= MOST_CHANGES:
            return [self]
        bounds = [0, *(each.at for each in changes), self.sample_count]
        rates_hz = [changes[0].before_hz, *(each.after_hz for each in changes)]
        found: list[Stream] = []
        for (begin, end), rate_hz in zip(pairwise(bounds), rates_hz, strict=True):
            first, last = (
                float(self._indexed.stamps(self._file, at, at + 1)[0]) for at in (begin, end - 1)
            )
            is_usual = abs(rate_hz / self.header.rate - 1) < ODD_RATE
            part = self.with_rate(self.header.rate if is_usual else rate_hz)
            indexed = self._indexed.part(begin, end, first, last)
            part.__dict__ |= {"_indexed": indexed, "_span": (begin, end), "rate_changes": ()}
            part.sample_count, part.byte_count = end - begin, indexed.byte_count
            if found:
                part.number, part.untimed = number + len(found) - 1, 0
            found.append(part)
        return found

    def blocks(
        self, begin_s: float = -np.inf, end_s: float = np.inf, *, as_recorded: bool = True
    ) -> Iterator[Samples]:
        """Yield the samples from `begin_s` to before `end_s`, chunk by chunk.

        Samples with a NaN timestamp are left out.

        Parameters
        ----------
        begin_s, end_s
            On the recorder's clock, in s.
        as_recorded
            Whether also `stray` timestamps are those of the file.

        Raises
        ------
        RecordingError
            If the file cannot be read any more.
        """
        stray = {} if as_recorded else self.stray
        is_all = begin_s == -np.inf and end_s == np.inf
        for place in self._indexed.places():
            if not is_all and self._is_outside(place, begin_s, end_s):
                continue
            block = self._read(place)
            if stray:
                block = self._without(stray, place, block)
            times = self.clock.to_recorder(block.stamps, place.offsets_before)
            is_wanted = np.isfinite(times)
            if not is_all:
                is_wanted &= (times >= begin_s) & (times < end_s)
            samples = Samples(times, block.stamps, block.values).picked(is_wanted)
            if len(samples):
                yield samples

    def _read(self, place: Place) -> Block:
        block = self._indexed.read(self._file, place)
        if self._span is None:
            return block
        begin, end = (max(0, at - place.samples_before) for at in self._span)
        return Block(block.stamps[begin:end], block.values[begin:end])

    def _without(self, stray: dict[int, float], place: Place, block: Block) -> Block:
        begin = max(place.samples_before, self._span[0] if self._span else 0)
        here = [at for at in stray if begin <= at < begin + len(block.stamps)]
        if not here:
            return block
        stamps = block.stamps.copy()
        stamps[np.array(here) - begin] = [stray[at] for at in here]
        return replace(block, stamps=stamps)

    @cached_property
    def stray(self) -> dict[int, float]:
        """Timestamps, by the number of the sample in the file, in place of outliers.

        Such a timestamp of another program is far from those of the samples before and after it.
        """
        return {} if self.order_error else self._indexed.stray(self._file)

    @cached_property
    def clock_error(self) -> str:
        """Why its timestamps are not on an LSL clock, as in `xdf check`; empty if they are."""
        return clock_error(self.header, self.clock_offsets, self._course, self.sample_count)

    @cached_property
    def part_error(self) -> str:
        """How many of its timestamps are not on an LSL clock, as in `xdf check`; empty if none."""
        if self.clock_error or self.clock.restarts:
            return ""
        return off_in_part(
            self.header,
            self.clock_offsets,
            (self._indexed.earliest, self._indexed.latest),
            lambda: (each.stamps for each in self.blocks()),
        )

    def on_clock(self, samples: Samples) -> Samples:
        """Return only its samples on an LSL clock, if some samples are not."""
        if not self.part_error:
            return samples
        bounds = clock_bounds(self.header, self.clock_offsets)
        return samples.picked(is_between(samples.stamps, bounds))

    @cached_property
    def order_error(self) -> str:
        """Why its stamps are not times of measurement; empty if they are."""
        return order_error(self.header, self._course, self.sample_count)

    @cached_property
    def steps_far_back(self) -> int:
        """How often its time steps back by more than a second, at the ends of chunks."""
        found = self._indexed.end_stamps(self.stray)
        places = zip(found, self._indexed.places(), strict=True)
        if self.clock.restarts:
            times = [self.clock.to_recorder(ends, place.offsets_before) for ends, place in places]
            found = np.concatenate([np.empty(0), *times])
        return Course.of([found.ravel()]).far_back

    @cached_property
    def _course(self) -> Course:
        return Course.of([self._indexed.end_stamps().ravel()])

    def _is_outside(self, place: Place, begin_s: float, end_s: float) -> bool:
        # In an irregular stream, timestamps may lie outside the chunk's first and last one.
        if not self.header.is_regular:
            return False
        ends = self.clock.to_recorder(np.array([place.first, place.last]), place.offsets_before)
        return bool(ends.max() < begin_s or ends.min() >= end_s)

    def ends(self) -> tuple[float, float] | None:
        """Return the time of its first and of its last sample, in s; None if empty.

        In a stream with a rate, only the ends of chunks are looked at, within which timestamps are
        almost always ascending.
        """
        within = self._indexed.within
        found = np.concatenate([self._indexed.end_stamps(self.stray), within[:, :2]])
        if self.part_error:
            found = found.ravel()
            bounds = clock_bounds(self.header, self.clock_offsets)
            found = found[is_between(found, bounds)]
        if len(found) and self.clock.restarts:
            before = [each.offsets_before for each in self._indexed.places()]
            before += within[:, 2].astype(int).tolist()
            runs = zip(found, before, strict=True)
            found = np.concatenate([self.clock.to_recorder(ends, at) for ends, at in runs])
        else:
            # With one clock run, all chunks are converted at once: a day has millions of chunks.
            found = self.clock.to_recorder(found.ravel())
        found = found[np.isfinite(found)]
        return (float(found.min()), float(found.max())) if len(found) else None


def _meaning(header: RecordedHeader) -> StreamHeader:
    try:
        return read_header(header.xml)
    except SpecError:
        core = CoreFields(
            name=header.name,
            content_type=header.content_type,
            source_id=header.source_id,
            hostname=header.hostname,
            channel_count=header.channel_count,
            rate=header.rate,
            format=header.format,
        )
        return foreign_header(core, header.labels, header.units, header.replay)
