"""Exports text files for Kubios HRV: beat intervals and ECG.

Kubios reads beat intervals from a file with one number per line, in s or ms, and an ECG from a
file with one value per line, for which the user enters the rate (Kubios HRV user's guide,
"Supported data formats").
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby, repeat
from pathlib import Path

import numpy as np

from biosensor_common.quantities import ChannelFormat, ContentType, Unit, signal_type
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.exporter import (
    ExportOptions,
    Missing,
    Progress,
    SampleCount,
    timeline,
    with_reasons,
)
from biosensor_gateway.recording.export.marker_events import marker_streams, write_marker_table
from biosensor_gateway.recording.export.readme import README, write_readme
from biosensor_gateway.recording.export.runs import (
    BAD_GAP,
    Runs,
    Stretch,
    batches,
    longest_gap_s,
    stretches,
)
from biosensor_gateway.recording.export.tables import MARKERS, FileNames, numbers, quoted
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.figures import seconds_text

_IN_SECONDS = {Unit.SECONDS: 1.0, Unit.MILLISECONDS: 1e-3}
# If timestamps differ more from the sum of intervals, beats are missing in between.
_HOLE_S = 1.0
_GAPS = "_gaps.csv"
_MOST_NAMED = 3


_MEANS = f"""\
Each file is a text with one number per line, for Kubios HRV: intervals between heart beats,
or an ECG, whose rate Kubios asks for.

Intervals have no times of their own: missing beats cannot be seen in them.

{MARKERS}: what happened, with seconds since the start of the recording, because Kubios's own
files hold no markers. Its seconds minus those at which a file begins are the seconds in Kubios.
"""


class Kubios:
    """Writes a file for each stream of beat intervals and for each run of an ECG, and markers."""

    suffix = "_kubios"

    def write(
        self, chosen: Chosen, options: ExportOptions, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        target.mkdir()
        count = SampleCount(chosen, progress)
        notes: list[str] = []
        reserved = [Path(README).stem, Path(MARKERS).stem]
        names, files = FileNames(reserved), dict[int, list[str]]()
        for stream in chosen.streams:
            if _is_of(stream, ContentType.RR):
                (name,) = names.of(stream)
                path = target / f"{name}.txt"
                notes += _write_intervals(chosen, options, stream, path)
                files |= {stream.number: [path.name]} if path.exists() else {}
            elif _is_of(stream, ContentType.ECG) and stream.header.is_regular:
                made = _write_ecg(chosen, options, stream, target, names, notes)
                files |= {stream.number: made} if made else {}
            count.add(stream.sample_count)
        if not any(target.iterdir()):
            message = (
                f"{chosen.contents.path} has no beat intervals and no ECG in the "
                "selection, so nothing was written for Kubios"
            )
            raise RecordingError(RecordingReason.EMPTY, with_reasons(message, notes))
        if marker_streams(chosen):
            write_marker_table(chosen, options, target / MARKERS)
        write_readme(target, chosen, options, _MEANS, files, notes)
        return notes


def _is_of(stream: Stream, kind: ContentType) -> bool:
    header = stream.header
    return signal_type(header.content_type) == kind and header.format is not ChannelFormat.STRING


def _begins(chosen: Chosen, options: ExportOptions, path: Path, time_s: float) -> str:
    since_s = float(timeline(chosen, options.clock).since_zero(np.array([time_s]))[0])
    return f"{path.name} begins at {seconds_text(round(since_s, 3) + 0.0, 3)}"


def _write_intervals(
    chosen: Chosen, options: ExportOptions, stream: Stream, path: Path
) -> Iterator[str]:
    name, unit = stream.header.title, stream.meaning.units[0]
    if unit not in _IN_SECONDS:
        yield Missing(f"{name}: left out, because its unit is {unit!r}, neither s nor ms")
        return
    left_out, missing_s, begin_s, last_s = 0, 0.0, 0.0, None
    with path.open("xb") as file:
        for samples in batches(chosen, stream):
            intervals = np.asarray(samples.values)[:, 0]
            is_one = np.isfinite(intervals) & (intervals > 0)
            left_out += int(np.count_nonzero(~is_one))
            intervals, times = intervals[is_one], samples.times[is_one]
            if not len(times):
                continue
            file.writelines(each + b"\n" for each in numbers(intervals))
            if last_s is None:
                # An interval has the time of the beat that ends it.
                begin_s = float(times[0]) - float(intervals[0]) * _IN_SECONDS[Unit(unit)]
            steps = np.diff(times, prepend=times[0] if last_s is None else last_s)
            holes = steps - intervals * _IN_SECONDS[Unit(unit)]
            missing_s += float(holes[holes > _HOLE_S].sum())
            last_s = float(times[-1])
    if last_s is None:
        path.unlink()
        yield f"{name}: left out, because it has no intervals"
        return
    yield f"{name}: {_begins(chosen, options, path, begin_s)}"
    if left_out:
        yield f"{name}: {left_out} samples are not intervals and are left out"
    if missing_s:
        yield f"{name}: beats are missing between the intervals, {missing_s:.0f} s in total"


def _write_ecg(
    chosen: Chosen,
    options: ExportOptions,
    stream: Stream,
    folder: Path,
    names: FileNames,
    notes: list[str],
) -> list[str]:
    """Write an ECG and add notes for the user; return its file names."""
    name = stream.header.title
    cut = Runs(chosen, stream, options.times)
    runs = cut.found()
    if not runs:
        return []
    every = stretches(runs, stream.header.rate, longest_gap_s(options.times))
    if why := cut.left_out(len(runs), len(every)):
        notes.append(Missing(f"{name}: {why}"))
        return []
    files = [folder / f"{each}.txt" for each in names.of(stream, len(every))]
    file_of = [path for path, each in zip(files, every, strict=True) for _ in each.runs]
    empty = [rows for each in every for rows in each.empty]
    without = 0
    for number, parts in groupby(cut.pieces(), key=lambda each: each[0]):
        # A file that continues after a gap was created for an earlier run.
        goes_on = number > 0 and file_of[number] == file_of[number - 1]
        with file_of[number].open("ab" if goes_on else "xb") as file:
            file.writelines(repeat(b"NaN\n", empty[number]))
            for _, samples in parts:
                values = np.asarray(samples.values)[:, 0]
                without += int(np.count_nonzero(~np.isfinite(values)))
                file.writelines(each + b"\n" for each in numbers(values))
    rates = [each.rate_hz for each in every]
    told = ", ".join(f"{rate:.6g}" for rate in dict.fromkeys(rates[:3]))
    more = ", ..." if len(rates) > 3 else ""
    notes.append(f"{name}: tell Kubios its rate, {told}{more} Hz, and its unit, {_unit(stream)}")
    begun = [
        _begins(chosen, options, path, each.begin_s)
        for path, each in zip(files, every, strict=True)
    ]
    notes.append(f"{name}: {', '.join(begun[:_MOST_NAMED])}{', ...' * (len(begun) > _MOST_NAMED)}")
    if without:
        notes.append(f"{name}: {without} samples have no value and are NaN")
    notes += [f"{name}: {each}" for each in cut.remarks(every, "NaN stands")]
    if any(empty):
        notes.append(f"{name}: {_write_gaps(every, files)}")
    return [each.name for each in files]


def _write_gaps(every: Sequence[Stretch], files: Sequence[Path]) -> str:
    """Write lists of gaps next to the files with gaps; return a sentence about them."""
    made: list[str] = []
    for stretch, path in zip(every, files, strict=True):
        gaps = [
            (row + 1, row / stretch.rate_hz, rows / stretch.rate_hz, BAD_GAP)
            for row, rows in stretch.gaps
        ]
        if gaps:
            table = path.with_name(f"{path.stem}{_GAPS}")
            heads = ("first_line", "seconds", "duration", "event")
            table.write_bytes(quoted([heads, *gaps]))
            made.append(table.name)
    return f"its gaps are listed in {', '.join(made[:_MOST_NAMED])}"


def _unit(stream: Stream) -> str:
    return stream.meaning.units[0] or "not known"
