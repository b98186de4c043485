"""Exports a folder with a table per stream: one row per sample, one column per channel."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from biosensor_gateway.recording.contents.choice import Chosen, merged
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export import tables
from biosensor_gateway.recording.export.csv.by_rate import table_names, write_by_rate
from biosensor_gateway.recording.export.exporter import (
    Clock,
    Order,
    Progress,
    SampleCount,
    on_clock,
)
from biosensor_gateway.recording.export.marker_events import (
    MarkerEvent,
    gap_event,
    in_order,
    is_left_out,
    marker_events,
)
from biosensor_gateway.recording.export.readme import write_readme
from biosensor_gateway.recording.export.runs import BAD_GAP, Runs, batches, gap_text, has_even_times
from biosensor_gateway.recording.export.tables import MARKERS, file_names, rows_of_numbers
from biosensor_gateway.recording.export.timeline import Timeline, timeline

_MICROSECONDS = 6
CONTENTS = "streams.json"
"""File that describes the tables."""
_MEANS = f"""\
One table for each stream: a row for each sample, a column for each channel. NaN means that
there is no value. Where samples are missing, so are their rows.

Column {{time}}: when it was. Column seconds: the time since the recording begins, which is the
same for all tables.

{MARKERS}: what happened, with seconds since the start. undone is yes where a marker was taken
back later.

{CONTENTS}: unit of each column, rate, sensor and who wore it, for programs.

The files are UTF-8, columns are separated by commas, decimals have a point. In a spreadsheet
whose decimals are commas, import them as text with a point (in Excel: Data > From Text/CSV).
"""
_WIDE = """
all_...Hz: all streams of one rate side by side. Rows have equal steps; a sample is in the row
that is nearest to its time, nothing is interpolated, and a row in which nothing was measured is
left out. marker is what happened at that row, or since the one before.
"""


class WideCsv:
    """Writes a table for each stream that has samples, and ``streams.json``.

    Units, rates, participants and other facts about a stream are in the latter, because programs
    that read tables expect one line of names and then numbers.

    Parameters
    ----------
    is_packed
        Whether the tables are compressed by gzip.
    """

    suffix = "_csv"

    def __init__(self, *, is_packed: bool = False) -> None:
        self._is_packed = is_packed

    def write(
        self, chosen: Chosen, order: Order, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        target.mkdir()
        suffix = ".csv.gz" if self._is_packed else ".csv"
        count = SampleCount(chosen, progress)
        described: list[dict[str, Any]] = []
        even: list[tuple[Stream, Runs]] = []
        wide = table_names(chosen).values() if order.is_wide else ()
        names = file_names(chosen.streams, [Path(MARKERS).stem, *wide])
        for stream, name in zip(chosen.streams, names, strict=True):
            path = target / f"{name}{suffix}"
            given: Iterator[Samples] = batches(chosen, stream)
            if has_even_times(stream, order.times):
                even.append((stream, Runs(chosen, stream, order.times)))
                given = even[-1][1].samples()
            samples = self._write_stream(chosen, stream, given, order.clock, path, count)
            described.append(_described(stream, order.clock, samples, path.name))
        content = {
            "recording": chosen.contents.path.name,
            "clock": order.clock.value,
            "begun": chosen.contents.begun,
            "streams": described,
        }
        text = json.dumps(content, indent=2, ensure_ascii=False)
        (target / CONTENTS).write_text(text + "\n", "utf-8", newline="\n")
        _write_markers(chosen, order, even, target / MARKERS)
        notes: list[str] = []
        if order.is_wide:
            notes += write_by_rate(chosen, order, names, target, is_packed=self._is_packed)
        notes += [f"{stream.header.name}: {told}" for stream, runs in even for told in _told(runs)]
        files = {
            each.number: [f"{name}{suffix}"]
            for each, name in zip(chosen.streams, names, strict=True)
        }
        means = _MEANS.format(time=tables.time_column(order.clock))
        means += _WIDE if order.is_wide else ""
        write_readme(target, chosen, order, means, files, notes)
        return notes

    def _write_stream(
        self,
        chosen: Chosen,
        stream: Stream,
        given: Iterator[Samples],
        clock: Clock,
        path: Path,
        count: SampleCount,
    ) -> int:
        written = 0
        with tables.table_file(path, is_packed=self._is_packed) as file:
            heads = [tables.time_column(clock), tables.SECONDS, *tables.own_columns(stream)]
            file.write(tables.quoted([heads]))
            line = timeline(chosen, clock)
            for samples in given:
                file.write(_rows(chosen, clock, line, samples))
                written += len(samples)
                count.add(len(samples))
        return written


def _told(runs: Runs) -> Iterator[str]:
    yield from runs.remarks_on_times()
    if gaps := runs.gaps():
        text = gap_text([each.lost for each in gaps])
        yield f"{text}, each an event {BAD_GAP} in {MARKERS}; no row stands there"


def _write_markers(
    chosen: Chosen, order: Order, even: Sequence[tuple[Stream, Runs]], path: Path
) -> None:
    line = timeline(chosen, order.clock)
    streams = [each for each in chosen.streams if each.header.is_markers and not is_left_out(each)]

    def all_of_them() -> Iterator[tuple[Stream, MarkerEvent]]:
        for stream, samples in merged(streams, chosen.begin_s, chosen.end_s):
            for each in marker_events(stream, samples, line):
                yield stream, each

    with path.open("xb") as file:
        heads = ["seconds", tables.time_column(order.clock)]
        heads += ["marker", "note", "undone", "participant", "stream"]
        file.write(tables.quoted([heads]))
        gaps = (
            (stream, gap_event(stream, gap, line)) for stream, runs in even for gap in runs.gaps()
        )
        for stream, each in in_order(all_of_them(), gaps):
            told = (each.name or each.text, each.note, "yes" if each.undone else "no")
            times = (round(each.onset_s, 6), line.begin_s + each.onset_s)
            row = (*times, *told, each.participant, stream.header.name)
            file.write(tables.quoted([row]))


def _rows(chosen: Chosen, clock: Clock, line: Timeline, samples: Samples) -> bytes:
    times = on_clock(chosen, clock, samples.times)
    since = np.round(line.since_zero(samples.times), _MICROSECONDS)
    if isinstance(samples.values, list):
        rows = zip(times.tolist(), since.tolist(), samples.values, strict=True)
        return tables.quoted((time_s, since_s, *texts) for time_s, since_s, texts in rows)
    return rows_of_numbers(np.column_stack((times, since)), samples.values)


def _described(stream: Stream, clock: Clock, samples: int, file: str) -> dict[str, Any]:
    header, identity = stream.header, stream.header.identity
    return {
        "file": file,
        "name": header.name,
        "type": header.content_type,
        "source_id": header.source_id,
        "participant": identity.participant if identity else "",
        "sensor": identity.sensor if identity else "",
        "unit": identity.unit if identity else "",
        "nominal_rate_hz": header.rate,
        "format": header.format.value,
        "samples": samples,
        "columns": [
            {"name": tables.time_column(clock), "unit": "s"},
            {"name": tables.SECONDS, "unit": "s"},
            *(
                {"name": name, "label": label, "unit": unit}
                for name, label, unit in zip(
                    tables.own_columns(stream), header.labels, stream.meaning.units, strict=True
                )
            ),
        ],
    }
