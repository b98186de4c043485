"""Writes a BDF+ file for each run of each regular stream, with annotations of missing values."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.choice import BATCH, Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.edf.bdf import (
    MOST_CHARACTERS,
    RATES_HZ,
    Annotation,
    Channel,
    Facts,
    annotation_records,
    channel,
    digital,
    header,
    layout,
    records,
)
from biosensor_gateway.recording.export.exporter import (
    Clock,
    ExportOptions,
    Missing,
    Progress,
    SampleCount,
    Times,
    with_reasons,
)
from biosensor_gateway.recording.export.marker_events import markers
from biosensor_gateway.recording.export.readme import write_readme
from biosensor_gateway.recording.export.runs import (
    BAD_GAP,
    Runs,
    Stretch,
    longest_gap_s,
    stretches,
)
from biosensor_gateway.recording.export.tables import FileNames, unique
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

_MOST_NAMED = 5
Happened = tuple[float, str]
"""Time on the recorder's clock, in s, and text."""
INSTEAD = "the smallest value of the channel, below all measured ones, is written"
"""Describes what is written for missing values."""
_LABEL = 16
# The header has no room for more.
_MOST_CHANNELS = 4000
# In EDFlib, with the annotations.
_MOST_SIGNALS = 640
_MOST_TOLD = 1000


@dataclass(slots=True)
class _Job:
    """One export."""

    chosen: Chosen
    clock: Clock
    times: Times
    count: SampleCount
    happened: list[tuple[float, str]]
    notes: list[str] = field(default_factory=list[str])
    files: dict[int, list[str]] = field(default_factory=dict[int, list[str]])
    """File names by stream number."""


_MEANS = """\
Each file is EDF+ in 24 bits (BDF+); open it with EDFbrowser, EEGLAB or MNE. It holds one stream,
or, if that has gaps, the part between two of them.

Markers are annotations. So are the LSL time at which a file starts, by which files can be
aligned, and each place without a value: there the channel has its physical minimum, which is
below every value that was measured.

The last data record is filled up with the last sample; an annotation marks where this starts.
"""


class Edf:
    """Writes regular numeric streams; every file has the markers as annotations."""

    suffix = "_edf"

    def write(
        self, chosen: Chosen, options: ExportOptions, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        target.mkdir()
        count, happened = SampleCount(chosen, progress), sorted(markers(chosen))
        job = _Job(chosen, options.clock, options.times, count, happened)
        irregular, names = list[str](), FileNames()
        for stream in chosen.streams:
            if stream.header.is_markers:
                continue
            if not stream.header.is_regular:
                irregular.append(stream.header.title)
                continue
            _write_stream(job, stream, target, names)
        if irregular:
            told = ", ".join(irregular[:_MOST_NAMED])
            told += f" and {len(irregular) - _MOST_NAMED} more" * (len(irregular) > _MOST_NAMED)
            job.notes.append(
                f"without a rate, so left out, because EDF cannot hold it: {told}; --rate HZ "
                "helps if you know it"
            )
        if not any(target.iterdir()):
            message = (
                f"{chosen.contents.path} has no regular numeric streams in the selection that "
                "EDF can hold, so nothing was written as EDF"
            )
            raise RecordingError(RecordingReason.EMPTY, with_reasons(message, job.notes))
        if cut := sum(len(text) > MOST_CHARACTERS for _, text in happened):
            texts = "1 marker is" if cut == 1 else f"{cut} markers are"
            told = f"{texts} cut off after {MOST_CHARACTERS} characters; csv has all"
            job.notes.append(Missing(told))
        write_readme(target, chosen, options, _MEANS, job.files, job.notes)
        return job.notes


def _write_stream(job: _Job, stream: Stream, folder: Path, names: FileNames) -> None:
    name, cut = stream.header.title, Runs(job.chosen, stream, job.times)
    runs = cut.found()
    if not runs:
        return
    every = stretches(runs, stream.header.rate, longest_gap_s(job.times))
    if why := cut.left_out(len(runs), len(every)):
        job.notes.append(Missing(f"{name}: {why}"))
        return
    job.notes += [f"{name}: {told}" for told in cut.remarks(every, INSTEAD)]
    begins = [each.begin_s for each in every for _ in each.runs]
    holes = Holes(stream, begins)
    for number, samples in cut.pieces():
        holes.take(number, samples)
    job.notes += holes.notes()
    files = [folder / f"{each}.bdf" for each in names.of(stream, len(every))]
    left_out: set[str] = set()
    given = Given(cut)
    kept: list[tuple[Stretch, Path, list[Channel]]] = []
    for stretch, path in zip(every, files, strict=True):
        channels, without = channels_of(stream, stretch)
        left_out |= set(without)
        if channels and _has_rate(job, stream, stretch):
            kept.append((stretch, path, channels))
    if any(len(channels) >= _MOST_SIGNALS for _, _, channels in kept):
        job.notes.append(
            f"{name}: pyEDFlib and other programs based on EDFlib cannot open files of "
            f"{_MOST_SIGNALS} channels or more; MNE can"
        )
    happened = _dealt(job, stream, [each for each, _, _ in kept])
    for (stretch, path, channels), dealt_out in zip(kept, happened, strict=True):
        numbers = range(stretch.first, stretch.first + len(stretch.runs))
        missing = [each for number in numbers for each in holes.found[number]]
        told = sorted([*dealt_out, *missing])
        write_stretch(job.chosen, job.clock, stream, stretch, channels, told, given, path)
        job.count.add(sum(run.count for run in stretch.runs))
        job.files.setdefault(stream.number, []).append(path.name)
    if left_out:
        labels = ", ".join(sorted(left_out))
        told = f"{name}: without {labels}, whose values are beyond what EDF can hold"
        job.notes.append(Missing(told))


def _has_rate(job: _Job, stream: Stream, stretch: Stretch) -> bool:
    """Whether EDF supports the rate of a file."""
    if RATES_HZ[0] <= stretch.rate_hz <= RATES_HZ[1]:
        return True
    told = f"{stream.header.title}: a run of {stretch.rate_hz:g} Hz is left out, beyond EDF's rates"
    job.notes.append(Missing(told))
    return False


def _dealt(job: _Job, stream: Stream, kept: Sequence[Stretch]) -> list[list[Annotation]]:
    """Return the annotations of each file."""
    if not kept:
        return []
    spans = [Span(each.begin_s, each.begin_s + length_s(each)) for each in kept]
    found, outside = dealt_to_spans(job.happened, spans)
    if outside:
        job.notes.append(
            f"{stream.header.title}: {outside} of the markers came outside its samples; they are "
            "annotations of the file before, or of the first, at times that it does not cover"
        )
    return [
        [Annotation(time_s - stretch.begin_s, 0.0, text) for time_s, text in each]
        for each, stretch in zip(found, kept, strict=True)
    ]


class Span(NamedTuple):
    """Time range of one file, in s on the recorder's clock; the end is excluded."""

    begin_s: float
    end_s: float


def dealt_to_spans(
    happened: Sequence[Happened], spans: Sequence[Span]
) -> tuple[list[list[Happened]], int]:
    """Assign markers to files; return them by file, and how many are outside of all files.

    Those outside go to the previous file, or to the first one, because an annotation may have any
    time.

    Parameters
    ----------
    happened
        In time order.
    spans
        At least one, in any order.
    """
    found: list[list[Happened]] = []
    is_outside = [True] * len(happened)
    for span in spans:
        inside = range(
            bisect_left(happened, (span.begin_s, "")), bisect_left(happened, (span.end_s, ""))
        )
        found.append([happened[place] for place in inside])
        for place in inside:
            is_outside[place] = False
    outside = [each for each, it_is in zip(happened, is_outside, strict=True) if it_is]
    begins = sorted((span.begin_s, number) for number, span in enumerate(spans))
    for each in outside:
        place = bisect_right(begins, (each[0], len(spans)))
        found[begins[max(0, place - 1)][1]].append(each)
    return found, len(outside)


def length_s(stretch: Stretch) -> float:
    """Return the duration of a file, including padding."""
    plan = layout(stretch.rows, stretch.rate_hz)
    return plan.samples * plan.records / stretch.rate_hz


class Given:
    """Yields the values of runs; these must be requested in order."""

    def __init__(self, cut: Runs) -> None:
        self._pieces = cut.pieces()
        self._next = next(self._pieces, None)

    def _of(self, number: int) -> Iterator[NDArray[np.generic]]:
        while self._next is not None and self._next[0] <= number:
            found, samples = self._next
            if found == number:
                yield np.asarray(samples.values)
            self._next = next(self._pieces, None)

    def of_stretch(self, stretch: Stretch) -> Iterator[NDArray[np.generic]]:
        """Yield the values of its runs, with NaN in the rows between them."""
        for number, empty in enumerate(stretch.empty, stretch.first):
            for begin in range(0, empty, BATCH):
                yield np.full((min(BATCH, empty - begin), len(stretch.runs[0].least)), np.nan)
            yield from self._of(number)


def channels_of(stream: Stream, stretch: Stretch) -> tuple[list[Channel], list[str]]:
    """Return the channels to write, and the labels of those that cannot be written."""
    labels = stream.header.labels
    plain = ["".join(c if " " <= c <= "~" else "_" for c in each) for each in labels]
    short = [each[:_LABEL] for each in plain]
    if len(set(short)) < len(short):
        # Leaves room for a suffix that makes them unique.
        short = unique(each[: _LABEL - 5] for each in plain)
    lowest = np.min([each.least for each in stretch.runs], axis=0)
    highest = np.max([each.greatest for each in stretch.runs], axis=0)
    named = zip(short, stream.meaning.units, lowest, highest, strict=True)
    found = [
        channel(place, label, unit, float(least), float(greatest))
        for place, (label, unit, least, greatest) in enumerate(named)
    ]
    kept = [each for each in found if each is not None][:_MOST_CHANNELS]
    places = {each.place for each in kept}
    return kept, [label for place, label in enumerate(labels) if place not in places]


def write_stretch(
    chosen: Chosen,
    clock: Clock,
    stream: Stream,
    stretch: Stretch,
    channels: Sequence[Channel],
    happened: Sequence[Annotation],
    given: Given,
    path: Path,
) -> None:
    """Write a file.

    Parameters
    ----------
    happened
        Annotations besides those of its runs and gaps.
    given
        Source of its values, not yet read.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    plan = layout(stretch.rows, stretch.rate_hz)
    facts = _facts(chosen, clock, stream, stretch)
    told = sorted([*_of_file(stretch), *happened])
    texts, room = annotation_records(told, plan.records, plan.record_s, facts.start_s)
    with path.open("xb") as file:
        file.write(header(channels, plan, facts, room))
        steps = (digital(each, channels) for each in given.of_stretch(stretch))
        file.writelines(records(steps, plan.samples, texts, room))


def _facts(chosen: Chosen, clock: Clock, stream: Stream, stretch: Stretch) -> Facts:
    identity, wall = stream.header.identity, chosen.contents.wall
    begun_ns = None
    if clock is Clock.WALL and wall is not None:
        begun_ns = int(wall.to_unix_ns(np.array([stretch.begin_s]))[0])
    participant = identity.participant if identity else ""
    equipment = f"{identity.sensor}/{identity.unit}" if identity else stream.header.title
    return Facts(participant, equipment, begun_ns)


def _of_file(stretch: Stretch) -> Iterator[Annotation]:
    """Yield the annotations that describe a file's runs, gaps and padding."""
    rate_hz = stretch.rate_hz
    for row, run in stretch.begins:
        yield Annotation(row / rate_hz, 0.0, f"LSL time {run.begin_s:.6f} s")
    for row, rows in stretch.gaps:
        yield Annotation(row / rate_hz, rows / rate_hz, BAD_GAP)
    end_s = stretch.rows / rate_hz
    if (rest_s := length_s(stretch) - end_s) > 0.5 / rate_hz:
        yield Annotation(end_s, rest_s, "end of data, followed by padding")


class Holes:
    """Finds missing values in the samples of a stream.

    Parameters
    ----------
    begins
        Start time of the file of each run.
    """

    def __init__(self, stream: Stream, begins: Sequence[float]) -> None:
        self._stream, self._begins = stream, begins
        self.found: list[list[Annotation]] = [[] for _ in begins]  # Annotations of each run.
        # Start of the current gap of each channel; NaN outside of a gap.
        self._open = np.full(stream.header.channel_count, np.nan)
        self._number = -1
        self._last_s = 0.0
        self._untold = self._missing = 0

    def take(self, number: int, samples: Samples) -> None:
        """Process the next samples of a run."""
        if number != self._number:
            self._close_all()
            self._number = number
        values = np.asarray(samples.values)
        if values.dtype.kind != "f":
            return
        is_missing = ~np.isfinite(values)
        self._missing += int(np.count_nonzero(is_missing))
        was_missing = np.vstack((~np.isnan(self._open), is_missing[:-1]))
        for row, place in np.argwhere(is_missing != was_missing):
            time_s = float(samples.times[row])
            if is_missing[row, place]:
                self._open[place] = time_s
            else:
                self._close(int(place), time_s)
        self._last_s = float(samples.times[-1])

    def notes(self) -> Iterator[str]:
        """Yield sentences about missing values, after all samples were processed."""
        self._close_all()
        name = self._stream.header.title
        if self._missing:
            yield f"{name}: {self._missing} values are missing; annotations mark the places"
        if self._untold:
            yield f"{name}: {self._untold} more places are not annotated"

    def _close_all(self) -> None:
        for place in np.flatnonzero(~np.isnan(self._open)):
            self._close(int(place), self._last_s)

    def _close(self, place: int, end_s: float) -> None:
        begin_s = float(self._open[place])
        self._open[place] = np.nan
        told = self.found[self._number]
        if len(told) >= _MOST_TOLD:
            self._untold += 1
            return
        label = self._stream.header.labels[place]
        begin_s -= self._begins[self._number]
        length_s = max(0.0, end_s - self._begins[self._number] - begin_s)
        told.append(Annotation(begin_s, length_s, f"no value: {label}"))
