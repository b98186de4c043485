"""Opens a recording, and finds the rates that its headers do not name."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from pathlib import Path

from biosensor_gateway.recording.contents.stream import IndexedStream, Samples, Stream
from biosensor_gateway.recording.contents.wall_clock import WallClock, find_wall_clock
from biosensor_gateway.recording.recorder.state import require_ended
from biosensor_gateway.recording.xdf.container import Damage, open_recording, read_chunks
from biosensor_gateway.recording.xdf.event_rules import other_agent_told
from biosensor_gateway.recording.xdf.figures import cuts_of, first_of, may_have_rate
from biosensor_gateway.recording.xdf.pace import Cuts, Pace, find_pace, rate_of
from biosensor_gateway.recording.xdf.rate_changes import MOST_CHANGES, RateChange
from biosensor_gateway.recording.xdf.recording import StreamSorter
from biosensor_gateway.recording.xdf.report import Ends, Extent, extent_of, last_asked
from biosensor_gateway.recording.xdf.stream_rules import MIN_SAMPLES_FOR_RATE, WRONG_RATE

_MOST_RATES = 4


@dataclass(frozen=True, slots=True)
class Contents:
    """An open recording."""

    path: Path
    begun: str  # The recorder's text for the start time; empty if there is none.
    streams: tuple[Stream, ...]  # In the order of their headers, including streams without samples.
    damages: tuple[Damage, ...]  # Bytes that could not be read.
    # begin_s, end_s: of the recording's `Extent`, on the recorder's LSL clock in s.
    begin_s: float
    end_s: float
    wall: WallClock | None  # Relation to the time of day; None if unknown.

    @property
    def of_other_agents(self) -> list[str]:
        """Sentences about events of another agent, whose data may be another person's."""
        found: list[str] = []
        for stream, texts, ahead_s in self.events:
            told = other_agent_told(texts, self.begin_s - ahead_s)
            found += [f"{stream.header.title}: {told}"] if told else []
        return found

    @property
    def events(self) -> Iterator[tuple[Stream, list[str], float]]:
        """Agents' event streams with their texts and clock offsets."""
        for stream in self.streams:
            blocks = list(stream.blocks(-inf, inf)) if stream.header.is_events else []
            texts = [str(text) for block in blocks for (text,) in block.values]
            if texts:
                yield stream, texts, float(blocks[0].times[0] - blocks[0].stamps[0])

    @property
    def not_closed(self) -> str:
        """That the recorder did not close the file, as a sentence; empty if it did."""
        unclosed = [each.header.title for each in self.streams if each.is_unclosed]
        if not unclosed:
            return ""
        if len(unclosed) == len(self.streams):
            return "the file was not closed, so its end may be missing"
        more = f" and {len(unclosed) - 1} more" if len(unclosed) > 1 else ""
        return f"{unclosed[0]}{more} was not closed, so its end may be missing"

    @property
    def why_incomplete(self) -> str:
        """The unreadable parts, as the end of a sentence about missing data."""
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
        for number, (start, end) in sorter.headless.items():
            what = f"the samples of stream number {number} have no header"
            damages = (*damages, Damage(start, end, what))
        streams = tuple(Stream(file, number, each) for number, each in sorter.streams.items())
        span = extent(streams)
        begun = sorter.begun or ""
        wall = find_wall_clock(streams, begun, span.begin, sorter.clock)
        yield Contents(path, begun, streams, damages, span.begin, span.end, wall)


@contextmanager
def open_ended(path: Path) -> Generator[Contents]:
    """Open a recording, as `open_contents`, unless it is still being recorded.

    Raises
    ------
    ConfigError
        ``IN_USE`` if it is.
    RecordingError
        As `open_contents`.
    """
    require_ended(path)
    with open_contents(path) as contents:
        yield contents


def extent(streams: Sequence[Stream]) -> Extent:
    """Return the extent of some streams of a recording, as in `xdf check`."""
    ends = [
        Ends(each.header, not each.clock_error, *bounds)
        for each in streams
        if (bounds := each.ends()) is not None
    ]
    return extent_of(ends, last_asked(each.clock_offsets for each in streams))


def estimated_rate(stream: Stream) -> float | None:
    """Return the rate of a stream without one in its header; None if the samples show none."""
    if not may_have_rate(stream.header):
        return None
    return rate_of(first_of(samples.stamps for samples in stream.blocks()))


def with_true_rates(streams: Sequence[Stream]) -> tuple[tuple[Stream, ...], list[str]]:
    """Return the streams with corrected nominal rates, and a note for each correction.

    Unlike `with_rates`, it also replaces a wrong rate in another program's header.
    """
    rated, notes = with_rates(streams, {})
    found: list[Stream] = []
    for stream in rated:
        nominal_hz, true_hz = stream.header.rate, _true_rate(stream)
        if true_hz is None or abs(true_hz / nominal_hz - 1) <= WRONG_RATE:
            found.append(stream)
            continue
        found.append(stream.with_rate(true_hz))
        notes.append(
            f"{stream.header.title}: its header says {nominal_hz:g} Hz; it is treated as "
            f"{true_hz:.6g} Hz, the rate of a line through its timestamps"
        )
    return tuple(found), notes


def has_uneven_stamps(stream: Stream) -> bool:
    """Whether the stamps of another program's stream come in bursts or overlap."""
    pace = _pace(stream)
    return pace is not None and (pace.burst > 1 or pace.overlap_s > 0)


def with_steady_stamps(stream: Stream) -> tuple[Iterator[Samples], str]:
    """Return the samples of a stream, and what was done about their stamps; empty if nothing.

    If its clock stood still, or its first samples came late, all stamps are those of the lines
    that EDF has, as other stamps do not tell when these samples were measured.
    """
    header = stream.header
    given = () if stream.order_error else (each.stamps for each in stream.blocks())
    cuts = None if header.is_markers else cuts_of(given, header)
    pace = None if cuts is None else cuts.pace
    if cuts is None or pace is None or not (pace.standstills or pace.late_first):
        return stream.blocks(as_recorded=False), ""
    why = [f"its clock stood still for {sum(each.count for each in pace.standstills)} samples"]
    why = why if pace.standstills else []
    why += [f"its first {pace.late_first} samples came late"] if pace.late_first else []
    told = f"{' and '.join(why)}, so it has the times of a line through its earliest stamps"
    return _on_lines(stream, cuts), told


def _on_lines(stream: Stream, cuts: Cuts) -> Iterator[Samples]:
    done = 0
    for samples in stream.blocks():
        stamps = samples.stamps.copy()
        ends = [each - done for each in cuts.numbers if done < each < done + len(stamps)]
        for begin, end in pairwise([0, *ends, len(stamps)]):
            run = bisect_right(cuts.numbers, done + begin)
            first = done + begin - (cuts.numbers[run - 1] if run else 0)
            times = cuts.times(run, first, end - begin)
            if times is not None:
                stamps[begin:end] = times
        done += len(stamps)
        yield replace(samples, stamps=stamps, times=samples.times + stamps - samples.stamps)


def _true_rate(stream: Stream) -> float | None:
    pace = _pace(stream)
    return None if pace is None else 1.0 / pace.period_s


def _pace(stream: Stream) -> Pace | None:
    """Return the pace of the first samples; None if each stamp is exact, or there are too few."""
    header = stream.header
    if not header.is_regular or header.is_markers or header.has_exact_stamps or stream.order_error:
        return None
    stamps = first_of(samples.stamps for samples in stream.blocks())
    return find_pace(stamps, header.rate) if len(stamps) >= MIN_SAMPLES_FOR_RATE else None


def with_rates(
    streams: Sequence[Stream], wanted: Mapping[str, float]
) -> tuple[tuple[Stream, ...], list[str]]:
    """Return the streams with rates for those whose header has none, and a note for each.

    A stream whose rate changes becomes one for each rate.

    Parameters
    ----------
    wanted
        Rates in Hz that somebody knows of streams without one, by name or source_id, with ``*`` and
        ``?``.
    """
    found: list[Stream] = []
    notes = [
        f"{each.header.title}: {why}" for each in streams if (why := rates_told(each.rate_changes))
    ]
    for stream in one_rate_each(streams):
        name = stream.header.title
        known = [hz for fit, hz in wanted.items() if stream.fits(fit)]
        rate_hz = known[0] if known else estimated_rate(stream)
        if stream.header.is_regular or rate_hz is None:
            found.append(stream)
            continue
        found.append(stream.with_rate(rate_hz))
        taken = (
            f"about {rate_hz:.6g} Hz, as --rate says"
            if known
            else f"{rate_hz:.6g} Hz, the rate of a line through its timestamps"
        )
        notes.append(f"{name}: its header names no rate; it is treated as {taken}")
    without = [each for each in streams if not each.header.is_regular]
    notes += [
        f"--rate {fit}: no stream without a rate has that name"
        for fit in wanted
        if not any(each.fits(fit) for each in without)
    ]
    return tuple(found), notes


def one_rate_each(streams: Sequence[Stream]) -> tuple[Stream, ...]:
    """Return the streams; one whose rate changes becomes one for each rate."""
    found: list[Stream] = []
    number = max((each.number for each in streams), default=0)
    for stream in streams:
        parts = stream.parts(number + 1)
        number += len(parts) - 1
        found += parts
    return tuple(found)


def rates_told(changes: Sequence[RateChange]) -> str:
    """Return a sentence on a stream whose rate changes; empty if it does not change."""
    if not changes:
        return ""
    rates = [f"{changes[0].before_hz:.4g}", *(f"{each.after_hz:.4g}" for each in changes)]
    if len(changes) > MOST_CHANGES:
        return f"its rate changes {len(changes)} times, so its times of a line are wrong"
    told = ", then ".join(rates[:_MOST_RATES]) + ", ..." * (len(rates) > _MOST_RATES)
    return f"its rate changes: {told} Hz; each part with one rate stands by itself"
