"""Exports text files for Ledalab: time, conductance and marker, one line per sample.

Ledalab imports three columns without a heading (its "Text" formats): time in s, skin conductance
in microsiemens, and the number of a marker at this sample, else 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.quantities import ChannelFormat, ContentType, Unit, signal_type
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.exporter import (
    ExportOptions,
    Missing,
    Progress,
    SampleCount,
    on_clock,
    with_reasons,
)
from biosensor_gateway.recording.export.marker_events import markers, write_marker_table
from biosensor_gateway.recording.export.readme import README, write_readme
from biosensor_gateway.recording.export.runs import (
    BAD_GAP,
    Runs,
    batches,
    gap_text,
    on_line,
)
from biosensor_gateway.recording.export.tables import MARKERS, file_names, numbers, quoted
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.figures import longest_step_s
from biosensor_gateway.recording.xdf.pace import Cuts

CODES = "markers.csv"
"""What the numbers of markers mean."""
_MICROSIEMENS = {Unit.MICROSIEMENS.value, "uS", "\N{MICRO SIGN}S", "\N{GREEK SMALL LETTER MU}S"}
_CONDUCTANCES = {"s": 1e6, "siemens": 1e6, "ms": 1e3, "millisiemens": 1e3, "ns": 1e-3}
# Conversion by unit, in lower case: a factor, or the dividend for units of resistance.
_RESISTANCES = {
    prefix + ohm: scale
    for prefix, scale in {"": 1e6, "k": 1e3, "kilo": 1e3, "m": 1.0, "mega": 1.0}.items()
    for ohm in ("ohm", "ohms", "\N{GREEK SMALL LETTER OMEGA}")
}


_MEANS = f"""\
Each file is a text for Ledalab, which imports it as three columns: time in s, skin
conductance in microsiemens, and the number of the marker that fell on that sample, or 0.

{CODES}: what the numbers of markers mean.

{MARKERS}: all markers with their times, also those that fell on no sample of a file.
"""


class Ledalab:
    """Writes a file for each skin conductance stream, ``markers.csv`` and a table of markers."""

    suffix = "_ledalab"

    def write(
        self, chosen: Chosen, options: ExportOptions, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        target.mkdir()
        count = SampleCount(chosen, progress)
        happened, codes = _numbered(chosen)
        notes: list[str] = []
        files: dict[int, list[str]] = {}
        names = file_names(chosen.streams, [Path(README).stem, Path(MARKERS).stem])
        for stream, name in zip(chosen.streams, names, strict=True):
            if _is_conductance(stream):
                path = target / f"{name}.txt"
                notes += _write_stream(chosen, options, stream, happened, codes, path)
                files |= {stream.number: [path.name]} if path.exists() else {}
            count.add(stream.sample_count)
        if not any(target.iterdir()):
            message = (
                f"{chosen.contents.path} has no skin conductance in the selection, "
                "so nothing was written for Ledalab"
            )
            raise RecordingError(RecordingReason.EMPTY, with_reasons(message, notes))
        if codes:
            lines = quoted([("code", "marker"), *((code, text) for text, code in codes.items())])
            (target / CODES).write_bytes(lines)
        if len(happened):
            write_marker_table(chosen, options, target / MARKERS)
        write_readme(target, chosen, options, _MEANS, files, notes)
        return notes


def _is_conductance(stream: Stream) -> bool:
    header = stream.header
    is_gsr = signal_type(header.content_type) == ContentType.GSR
    return is_gsr and header.format is not ChannelFormat.STRING


def _numbered(chosen: Chosen) -> tuple[NDArray[np.float64], dict[str, int]]:
    """Return the time and number of each marker, shape (n, 2), and the numbers by text."""
    codes: dict[str, int] = {}
    happened = [
        (time_s, codes.setdefault(text, len(codes) + 1)) for time_s, text in markers(chosen)
    ]
    return np.array(sorted(happened), np.float64).reshape(-1, 2), codes


def _write_stream(
    chosen: Chosen,
    options: ExportOptions,
    stream: Stream,
    happened: NDArray[np.float64],
    codes: dict[str, int],
    path: Path,
) -> Iterator[str]:
    unit = stream.meaning.units[0]
    told_of = _Told()
    place, begin_s = 0, None
    behind_holes = None
    given: Iterator[Samples] = batches(chosen, stream)
    # Of samples with one time, Ledalab would see a single one.
    runs, cuts = on_line(chosen, stream, options.times)
    if runs is not None:
        given = runs.samples()
        happened = _with_gaps(happened, runs, stream, codes)
    else:
        behind_holes = None if cuts is None else _behind_holes(chosen, stream, cuts)
    with path.open("xb") as file:
        for samples in given:
            values = _in_microsiemens(np.asarray(samples.values)[:, 0], unit)
            has_value = np.isfinite(values)
            told_of.without += int(np.count_nonzero(~has_value))
            times, values = samples.times[has_value], values[has_value]
            if not len(times):
                continue
            if begin_s is None:
                begin_s = float(times[0])
                place = int(np.searchsorted(happened[:, 0], begin_s))
            end = int(np.searchsorted(happened[:, 0], float(times[-1]), side="right"))
            here = happened[place : max(place, end)]
            here_codes, lost = _at_samples(here, times)
            told_of.together += lost
            told_of.late += _late(here, times, stream, behind_holes)
            told_of.inside += len(here)
            place = max(place, end)
            told = on_clock(chosen, options.clock, times)
            rows = zip(numbers(told), numbers(values), numbers(here_codes), strict=True)
            file.writelines(b"%b\t%b\t%b\n" % row for row in rows)
    if begin_s is None:
        path.unlink()
        yield Missing(f"{stream.header.title}: left out, because it has no values")
        return
    if unit.lower() in _CONDUCTANCES | _RESISTANCES:
        yield f"{stream.header.title}: its values were converted from {unit} to microsiemens"
    elif unit not in _MICROSIEMENS:
        yield (
            f"{stream.header.title}: its unit is {unit!r}, and Ledalab interprets it as "
            "microsiemens"
        )
    for what in told_of.sentences(len(happened)):
        yield f"{stream.header.title}: {what}"
    for what in _about_times(chosen, stream, runs, cuts):
        yield f"{stream.header.title}: {what}"


def _about_times(
    chosen: Chosen, stream: Stream, runs: Runs | None, cuts: Cuts | None
) -> Iterator[str]:
    """Yield sentences on what was done about times, and on gaps and steps back of recorded ones."""
    if runs is not None:
        yield from runs.remarks_on_times()
        if gaps := runs.gaps():
            told = gap_text([each.lost for each in gaps])
            yield f"{told}; the marker {BAD_GAP} precedes each gap"
        return
    lost: list[int] = []
    back = 0
    if cuts is not None:
        lost = [each.lost for each in cuts.holes]
        back = len(cuts.numbers) - len(lost)
    elif stream.header.is_regular:
        last = np.empty(0)
        for samples in batches(chosen, stream):
            steps = np.diff(np.concatenate([last, samples.times]))
            last = samples.times[-1:]
            gaps = steps[steps > longest_step_s(stream.header)]
            lost += (np.rint(gaps * stream.header.rate).astype(np.int64) - 1).tolist()
            back += int(np.count_nonzero(steps < 0))
    if lost:
        yield f"{gap_text(lost)}; the column of times steps over them"
    if back:
        times = "once" if back == 1 else f"{back} times"
        yield f"its time steps back {times}, so its samples are not in the order of their times"


def _with_gaps(
    happened: NDArray[np.float64], runs: Runs, stream: Stream, codes: dict[str, int]
) -> NDArray[np.float64]:
    """Return the markers with additional ones at the last sample before each gap."""
    gaps = runs.gaps()
    if not gaps:
        return happened
    code = codes.setdefault(BAD_GAP, len(codes) + 1)
    # Between the last two samples before the gap, so that it is assigned to the last one.
    own = [(each.begin_s - 1.5 / stream.header.rate, code) for each in gaps]
    together = np.concatenate((happened, np.array(own, np.float64)))
    return together[np.argsort(together[:, 0], kind="stable")]


def _in_microsiemens(values: NDArray[Any], unit: str) -> NDArray[Any]:
    """Return conductances; a resistance of zero becomes NaN."""
    name = unit.lower().replace("\N{OHM SIGN}", "\N{GREEK SMALL LETTER OMEGA}")
    if name in _CONDUCTANCES:
        return values * _CONDUCTANCES[name]
    if name in _RESISTANCES:
        with np.errstate(divide="ignore", invalid="ignore"):
            return _RESISTANCES[name] / np.asarray(values, np.float64)
    return values


@dataclass(slots=True)
class _Told:
    """Counts samples and markers that a file does not contain unchanged."""

    without: int = 0
    inside: int = 0
    late: int = 0
    together: int = 0

    def sentences(self, markers: int) -> Iterator[str]:
        if self.without:
            yield f"{self.without} samples have no value and are left out"
        if outside := markers - self.inside:
            yield (
                f"{outside} of the markers came before its first or after its last sample: only "
                f"{MARKERS} has them"
            )
        if self.late:
            yield (
                f"{self.late} of the markers fell where samples are missing, and are placed at "
                "the next sample"
            )
        if self.together:
            yield (
                f"{self.together} markers fall on a sample that already has one: only {MARKERS} "
                "has them"
            )


def _behind_holes(chosen: Chosen, stream: Stream, cuts: Cuts) -> NDArray[np.float64]:
    """Return the times of the samples after gaps."""
    places = np.array([each.at for each in cuts.holes], np.int64)
    found: list[NDArray[np.float64]] = []
    done = 0
    for samples in batches(chosen, stream):
        is_here = (places >= done) & (places < done + len(samples))
        found.append(samples.times[places[is_here] - done])
        done += len(samples)
    return np.concatenate([np.empty(0), *found])


def _late(
    happened: NDArray[np.float64],
    times: NDArray[np.float64],
    stream: Stream,
    behind_holes: NDArray[np.float64] | None,
) -> int:
    """Count the markers in gaps, which are assigned to the next sample."""
    places = np.minimum(np.searchsorted(times, happened[:, 0]), len(times) - 1)
    if behind_holes is not None:
        return int(np.count_nonzero(np.isin(times[places], behind_holes)))
    return int(np.count_nonzero(times[places] - happened[:, 0] > longest_step_s(stream.header)))


def _at_samples(
    happened: NDArray[np.float64], times: NDArray[np.float64]
) -> tuple[NDArray[np.int64], int]:
    """Return the marker number of each sample, 0 for none, and how many did not fit."""
    codes = np.zeros(len(times), np.int64)
    places = np.minimum(np.searchsorted(times, happened[:, 0]), len(times) - 1)
    codes[places[::-1]] = happened[::-1, 1]
    return codes, len(places) - len(set(places.tolist()))
