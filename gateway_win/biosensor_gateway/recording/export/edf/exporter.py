"""Writes a BDF+ file for each run of each regular stream."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.edf.bdf import (
    MOST_CHARACTERS,
    RATES_HZ,
    Annotation,
    Channel,
)
from biosensor_gateway.recording.export.edf.file import (
    INSTEAD,
    Given,
    Holes,
    channels_of,
    length_s,
    write_stretch,
)
from biosensor_gateway.recording.export.exporter import (
    Clock,
    Missing,
    Order,
    Progress,
    SampleCount,
    Times,
    with_reasons,
)
from biosensor_gateway.recording.export.marker_events import markers
from biosensor_gateway.recording.export.readme import write_readme
from biosensor_gateway.recording.export.runs import (
    MOST_RUNS,
    Runs,
    Stretch,
    longest_gap_s,
    stretches,
)
from biosensor_gateway.recording.export.tables import FileNames
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

_MOST_NAMED = 5
Happened = tuple[float, str]
"""Time on the recorder's clock, in s, and text."""


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
Each file is EDF+ in 24 bits (BDF+); open it with EDFbrowser, EEGLAB or MNE. It has one stream,
and if that has gaps, what is between two of them.

Markers are annotations. So is the LSL time at which a file begins, by which files can be
aligned, and each place where there is no value: the least value that the channel can have stands
there (its physical minimum), which is below every value that was measured.

The last data record is filled up with the last sample; an annotation says from where on.
"""


class Edf:
    """Writes regular numeric streams; every file has the markers as annotations."""

    suffix = "_edf"

    def write(
        self, chosen: Chosen, order: Order, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        target.mkdir()
        count, happened = SampleCount(chosen, progress), sorted(markers(chosen))
        job = _Job(chosen, order.clock, order.times, count, happened)
        irregular, names = list[str](), FileNames()
        for stream in chosen.streams:
            if stream.header.is_markers:
                continue
            if not stream.header.is_regular:
                irregular.append(stream.header.name)
                continue
            _write_stream(job, stream, target, names)
        if irregular:
            told = ", ".join(irregular[:_MOST_NAMED])
            told += f" and {len(irregular) - _MOST_NAMED} more" * (len(irregular) > _MOST_NAMED)
            job.notes.append(
                f"without a rate, so left out, for EDF cannot hold it: {told}; --rate HZ helps if "
                "you know it"
            )
        if not any(target.iterdir()):
            message = (
                f"{chosen.contents.path} has no regular numeric streams in the selection that "
                "EDF can hold, so nothing was written as EDF"
            )
            raise RecordingError(RecordingReason.EMPTY, with_reasons(message, job.notes))
        if cut := sum(len(text) > MOST_CHARACTERS for _, text in happened):
            texts = "1 marker is" if cut == 1 else f"{cut} markers are"
            job.notes.append(f"{texts} cut off after {MOST_CHARACTERS} characters; csv has all")
        write_readme(target, chosen, order, _MEANS, job.files, job.notes)
        return job.notes


def _write_stream(job: _Job, stream: Stream, folder: Path, names: FileNames) -> None:
    name, cut = stream.header.name, Runs(job.chosen, stream, job.times)
    runs = cut.found()
    if len(runs) > MOST_RUNS:
        job.notes.append(Missing(f"{name}: left out, because it has more than {MOST_RUNS} gaps"))
        return
    if not runs:
        return
    every = stretches(runs, stream.header.rate, longest_gap_s(job.times))
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
        job.notes.append(f"{name}: without {labels}, whose values are beyond what EDF can hold")


def _has_rate(job: _Job, stream: Stream, stretch: Stretch) -> bool:
    """Whether EDF supports the rate of a file."""
    if RATES_HZ[0] <= stretch.rate_hz <= RATES_HZ[1]:
        return True
    job.notes.append(f"{stream.header.name}: a run of {stretch.rate_hz:g} Hz left out")
    return False


def _dealt(job: _Job, stream: Stream, kept: Sequence[Stretch]) -> list[list[Annotation]]:
    """Return the annotations of each file."""
    if not kept:
        return []
    spans = [Span(each.begin_s, each.begin_s + length_s(each)) for each in kept]
    found, outside = dealt_to_spans(job.happened, spans)
    if outside:
        job.notes.append(
            f"{stream.header.name}: {outside} of the markers came outside of its samples; they "
            "are annotations of the file before, or of the first, at times that it does not cover"
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
