"""Exports tables in CSV: one per stream, or a wide one per rate with all streams side by side."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export import tables
from biosensor_gateway.recording.export.exporter import (
    Clock,
    ExportOptions,
    Missing,
    Progress,
    SampleCount,
    Timeline,
    on_clock,
    timeline,
)
from biosensor_gateway.recording.export.grid import Grid, write_rows
from biosensor_gateway.recording.export.marker_events import markers, write_marker_table
from biosensor_gateway.recording.export.readme import write_readme
from biosensor_gateway.recording.export.runs import (
    BAD_GAP,
    Runs,
    batches,
    gap_text,
    has_even_times,
    on_line,
)
from biosensor_gateway.recording.export.tables import (
    MARKERS,
    file_names,
    rows_of_numbers,
    tidied,
    unique,
)
from biosensor_gateway.recording.export.time_axis import find_timing

_MICROSECONDS = 6
CONTENTS = "streams.json"
"""File that describes the tables."""
_MEANS = f"""\
One table for each stream: a row for each sample, a column for each channel. NaN means that
there is no value. Where samples are missing, so are their rows.

Column {{time}}: the time of the sample. Column seconds: the time since the start of the recording,
which is the same for all tables.

{MARKERS}: what happened, with seconds since the start. undone is yes where a marker was taken
back later.

{CONTENTS}: unit of each column, rate, sensor and who wore it, for programs.

The files are UTF-8, columns are separated by commas, decimals have a point. In a spreadsheet
whose decimals are commas, import them as text with a point (in Excel: Data > From Text/CSV).
"""
_WIDE = """
all_...Hz: all streams of one rate side by side. Rows have equal steps; a sample is in the row
nearest to its time, nothing is interpolated, and a row in which nothing was measured is left
out. marker is the event at that row, or since the row before.
"""
MARKER = "marker"
# Number of rows written at once.
_BLOCK = 4096
_MOST_ROWS = 1e15
"""Behind more, a float64 no longer tells one row from the next."""
Array = NDArray[np.float64]


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
        self, chosen: Chosen, options: ExportOptions, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        target.mkdir()
        suffix = ".csv.gz" if self._is_packed else ".csv"
        count = SampleCount(chosen, progress)
        described: list[dict[str, Any]] = []
        even: list[tuple[Stream, Runs]] = []
        wide = table_names(chosen).values() if options.is_wide else ()
        names = file_names(chosen.streams, [Path(MARKERS).stem, *wide])
        for stream, name in zip(chosen.streams, names, strict=True):
            path = target / f"{name}{suffix}"
            given: Iterator[Samples] = batches(chosen, stream)
            if has_even_times(stream, options.times):
                even.append((stream, Runs(chosen, stream, options.times)))
                given = even[-1][1].samples()
            samples = self._write_stream(chosen, stream, given, options.clock, path, count)
            described.append(_described(stream, options.clock, samples, path.name))
        content = {
            "recording": chosen.contents.path.name,
            "clock": options.clock.value,
            "begun": chosen.contents.begun,
            "streams": described,
        }
        text = json.dumps(content, indent=2, ensure_ascii=False)
        (target / CONTENTS).write_text(text + "\n", "utf-8", newline="\n")
        gaps = [(stream, gap) for stream, runs in even for gap in runs.gaps()]
        write_marker_table(chosen, options, target / MARKERS, gaps)
        notes: list[str] = []
        if options.is_wide:
            notes += write_by_rate(chosen, options, names, target, is_packed=self._is_packed)
        notes += [f"{stream.header.title}: {told}" for stream, runs in even for told in _told(runs)]
        files = {
            each.number: [f"{name}{suffix}"]
            for each, name in zip(chosen.streams, names, strict=True)
        }
        means = _MEANS.format(time=tables.time_column(options.clock))
        means += _WIDE if options.is_wide else ""
        write_readme(target, chosen, options, means, files, notes)
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
        yield f"{text}, each an event {BAD_GAP} in {MARKERS}; there is no row"


def _to_microseconds(seconds: Array) -> Array:
    """Return rounded times; those that are beyond all clocks have no microseconds to round to."""
    is_far = np.abs(seconds) > _MOST_ROWS
    return np.where(is_far, seconds, np.round(np.where(is_far, 0.0, seconds), _MICROSECONDS))


def _rows(chosen: Chosen, clock: Clock, line: Timeline, samples: Samples) -> bytes:
    times = on_clock(chosen, clock, samples.times)
    since = _to_microseconds(line.since_zero(samples.times))
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


@dataclass(frozen=True, slots=True)
class _Member:
    """A stream in a table: its runs if it has even times, and its real rate."""

    stream: Stream
    runs: Runs | None
    rate_hz: float

    def samples(self, chosen: Chosen) -> Iterator[Samples]:
        """Yield its samples."""
        return batches(chosen, self.stream) if self.runs is None else self.runs.samples()


class _Cells:
    """Collects rows of numbers; see :class:`.Rows`."""

    def __init__(self) -> None:
        self.parts: list[Array | int] = []  # Blocks of values, or numbers of empty rows.

    def write(self, samples: Samples, count: int) -> None:
        """See :class:`.Rows`."""
        values = np.asarray(samples.values)[:count]
        is_float = values.dtype.kind == "f"
        self.parts.append(tidied(values) if is_float else values.astype(np.float64))

    def leave_empty(self, rows: int, width: int) -> None:
        """See :class:`.Rows`."""
        del width
        self.parts.append(rows)


class _Column:
    """The cells of one stream, block by block."""

    def __init__(self, samples: Iterator[Samples], rate_hz: float, width: int) -> None:
        self.width = width
        self._cells = _Cells()
        self.grid = Grid(self._cells, 0.0, rate_hz)
        self._steps = write_rows(self.grid, samples)
        self._waiting: deque[tuple[int, Array]] = deque()
        self._find_more()

    @property
    def next_row(self) -> int | None:
        """Row of its next sample; None at the end."""
        return self._waiting[0][0] if self._waiting else None

    def put(self, begin: int, into: Array, has_sample: NDArray[np.bool_]) -> None:
        """Copy the samples of a block of rows to it.

        Parameters
        ----------
        into : ndarray of float64, shape (n_rows, n_channels)
        has_sample : ndarray of bool, shape (n_rows,)
        """
        end = begin + len(into)
        while self.next_row is not None and self.next_row < end:
            row, values = self._waiting.popleft()
            count = min(len(values), end - row)
            into[row - begin : row - begin + count] = values[:count]
            has_sample[row - begin : row - begin + count] = True
            if count < len(values):
                self._waiting.appendleft((row + count, values[count:]))
            elif not self._waiting:
                self._find_more()

    def _find_more(self) -> None:
        while not self._waiting and next(self._steps, None) is not None:
            parts, self._cells.parts = self._cells.parts, []
            row = self.grid.last_row + 1
            row -= sum(each if isinstance(each, int) else len(each) for each in parts)
            for part in parts:
                if isinstance(part, int):
                    row += part
                else:
                    self._waiting.append((row, part))
                    row += len(part)


def table_names(chosen: Chosen) -> dict[float, str]:
    """Return the name, without suffix, of the table of each rate in a recording."""
    rates = {each.header.rate for each in chosen.streams if _is_signal(each)}
    return {rate: f"all_{rate:g}Hz" for rate in sorted(rates)}


def _is_signal(stream: Stream) -> bool:
    return stream.header.is_regular and not stream.header.is_markers


def write_by_rate(
    chosen: Chosen, options: ExportOptions, names: Sequence[str], target: Path, *, is_packed: bool
) -> list[str]:
    """Write a table for each rate; return notes for the user.

    Parameters
    ----------
    names
        Names of the streams, used as prefixes of the columns.

    Raises
    ------
    OSError
        If a table cannot be written.
    """
    notes: list[str] = []
    called = {each.number: name for each, name in zip(chosen.streams, names, strict=True)}
    happened = sorted(markers(chosen))
    for rate, table in table_names(chosen).items():
        found = [each for each in chosen.streams if _is_signal(each) and each.header.rate == rate]
        members = [_member(chosen, options, each, notes) for each in found]
        kept = [each for each in members if each is not None]
        if kept:
            path = target / f"{table}{'.csv.gz' if is_packed else '.csv'}"
            with tables.table_file(path, is_packed=is_packed) as file:
                notes += [
                    f"{path.name}: {told}"
                    for told in _write_table(file, chosen, options, kept, called, happened)
                ]
    return notes


def _member(
    chosen: Chosen, options: ExportOptions, stream: Stream, notes: list[str]
) -> _Member | None:
    """Return a stream's part of a table; None, with a note, if it cannot be in one."""
    runs, cuts = on_line(chosen, stream, options.times)
    given = _Member(stream, runs, 0.0).samples(chosen)
    timing = find_timing((each.times for each in given), stream.header, cuts, np.inf)
    if timing is None:
        return None
    why = stream.clock_error or ("its time steps back" if len(timing.parts) > 1 else "")
    away_s = abs(next(iter(timing.parts)).start_s - timeline(chosen, options.clock).zero_s)
    if not why and (timing.rows > _MOST_ROWS or away_s > _MOST_ROWS / timing.rate_hz):
        why = "its timestamps are too far apart"
    if why:
        told = f"{stream.header.title}: in no wide table, because {why}; its own table contains it"
        notes.append(Missing(told))
        return None
    return _Member(stream, runs, timing.rate_hz)


def _write_table(
    file: BinaryIO,
    chosen: Chosen,
    options: ExportOptions,
    members: Sequence[_Member],
    called: Mapping[int, str],
    happened: Sequence[tuple[float, str]],
) -> Iterator[str]:
    """Write one table; yield sentences about the distances between samples and rows."""
    # At the fastest real rate, each sample gets its own row.
    rate_hz = max(each.rate_hz for each in members)
    line = timeline(chosen, options.clock)
    zero_s = line.zero_s
    columns = [
        _Column(
            (replace(some, times=some.times - zero_s) for some in each.samples(chosen)),
            rate_hz,
            each.stream.header.channel_count,
        )
        for each in members
    ]
    heads = [
        f"{called[each.stream.number]}.{name}"
        for each in members
        for name in tables.columns(each.stream)
    ]
    lead = [tables.SECONDS, tables.time_column(options.clock)]
    file.write(tables.quoted([unique([*lead, *heads, MARKER])]))
    # A marker of another clock may have any time.
    most = _MOST_ROWS / rate_hz
    told = deque(
        (round(min(max(time_s - zero_s, -most), most) * rate_hz), text) for time_s, text in happened
    )
    while rows := [each.next_row for each in columns if each.next_row is not None]:
        begin = min(rows)
        values = np.full((_BLOCK, sum(each.width for each in columns)), np.nan)
        has_sample = np.zeros(_BLOCK, bool)
        at = 0
        for each in columns:
            each.put(begin, values[:, at : at + each.width], has_sample)
            at += each.width
        kept = np.flatnonzero(has_sample)
        times = zero_s + (begin + kept) / rate_hz
        since = np.round(line.since_zero(times), _MICROSECONDS)
        lead_times = np.column_stack((since, on_clock(chosen, options.clock, times)))
        text = rows_of_numbers(lead_times, values[kept])
        file.write(_with_markers(text, begin + kept, told))
    away_s = max(each.grid.displacement.largest for each in columns) / rate_hz
    yield (
        f"{len(members)} {'stream' if len(members) == 1 else 'streams'} in rows of {rate_hz:.9g} "
        f"Hz; a sample is at most {round(away_s * 1e3, 3):g} ms from the time of its row"
    )
    if moved := sum(each.grid.displacement.moved for each in columns):
        yield f"{moved} samples are not in the row of their time, because it was taken"
    if told:
        markers_came = "1 marker came" if len(told) == 1 else f"{len(told)} markers came"
        yield f"{markers_came} after its last row: only {tables.MARKERS} has them"


def _with_markers(text: bytes, rows: NDArray[np.int64], told: deque[tuple[int, str]]) -> bytes:
    """Return lines with the markers at each row, or before it if they have no row."""
    here: dict[int, list[str]] = {}
    while told and told[0][0] <= rows[-1]:
        row, marker = told.popleft()
        here.setdefault(int(np.searchsorted(rows, row)), []).append(marker)
    if not here:
        return text.replace(b"\n", b",\n")
    lines = text.splitlines()
    for place, line in enumerate(lines):
        happened = here.get(place)
        # Without the line end that `quoted` adds.
        cell = tables.quoted([["; ".join(happened)]])[:-1] if happened else b""
        lines[place] = line + b"," + cell + b"\n"
    return b"".join(lines)
