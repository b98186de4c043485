"""Texts for Kubios HRV: intervals between beats, and ECG.

Kubios reads intervals from a file with one number a line, in s or ms, and an ECG from
one with a value a line, for which it asks the rate (Kubios HRV user's guide, "Supported data
formats").
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from biosensor_common.quantities import ChannelFormat, ContentType, Unit
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.batches import batches
from biosensor_gateway.recording.export.exporter import (
    Missing,
    Order,
    Progress,
    SampleCount,
    with_reasons,
)
from biosensor_gateway.recording.export.names import FileNames
from biosensor_gateway.recording.export.numbers import numbers
from biosensor_gateway.recording.export.runs import MOST_RUNS, Runs
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

_IN_SECONDS = {Unit.SECONDS: 1.0, Unit.MILLISECONDS: 1e-3}
# Intervals that differ more from their stamps have a hole between them.
_HOLE_S = 1.0


class Kubios:
    """Writes a file of intervals for each stream of these, and one for each run of an ECG."""

    suffix = "_kubios"

    def write(
        self, chosen: Chosen, order: Order, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        target.mkdir()
        count = SampleCount(chosen, progress)
        notes: list[str] = []
        names = FileNames()
        for stream in chosen.streams:
            if _is_of(stream, ContentType.RR):
                (name,) = names.of(stream)
                notes += _write_intervals(chosen, stream, target / f"{name}.txt")
            elif _is_of(stream, ContentType.ECG) and stream.header.is_regular:
                notes += _write_ecg(chosen, stream, target, names)
            count.add(stream.sample_count)
        if not any(target.iterdir()):
            message = (
                f"{chosen.contents.path} holds no intervals between beats and no ECG of what is "
                "wanted, so nothing was written for Kubios"
            )
            raise RecordingError(RecordingReason.EMPTY, with_reasons(message, notes))
        return notes


def _is_of(stream: Stream, kind: ContentType) -> bool:
    header = stream.header
    return header.content_type == kind and header.format is not ChannelFormat.STRING


def _write_intervals(chosen: Chosen, stream: Stream, path: Path) -> Iterator[str]:
    name, unit = stream.header.name, stream.meaning.units[0]
    if unit not in _IN_SECONDS:
        yield Missing(f"{name}: left out, for its unit is {unit!r}, neither s nor ms")
        return
    left_out, missing_s, last_s = 0, 0.0, None
    with path.open("xb") as file:
        for samples in batches(chosen, stream):
            intervals = np.asarray(samples.values)[:, 0]
            is_one = np.isfinite(intervals) & (intervals > 0)
            left_out += int(np.count_nonzero(~is_one))
            intervals, times = intervals[is_one], samples.times[is_one]
            if not len(times):
                continue
            file.writelines(each + b"\n" for each in numbers(intervals))
            steps = np.diff(times, prepend=times[0] if last_s is None else last_s)
            holes = steps - intervals * _IN_SECONDS[Unit(unit)]
            missing_s += float(holes[holes > _HOLE_S].sum())
            last_s = float(times[-1])
    if last_s is None:
        path.unlink()
        yield f"{name}: left out, for it has no interval"
        return
    if left_out:
        yield f"{name}: {left_out} samples are no interval and left out"
    if missing_s:
        yield f"{name}: beats of {missing_s:.0f} s in all are missing between the intervals"


def _write_ecg(chosen: Chosen, stream: Stream, folder: Path, names: FileNames) -> Iterator[str]:
    name = stream.header.name
    cut = Runs(chosen, stream)
    runs = cut.found()
    if len(runs) > MOST_RUNS:
        yield Missing(f"{name}: left out, for it has more than {MOST_RUNS} gaps")
        return
    files = [folder / f"{each}.txt" for each in names.of(stream, len(runs))]
    without = 0
    for number, parts in groupby(cut.pieces(), key=lambda each: each[0]):
        with files[number].open("xb") as file:
            for _, samples in parts:
                values = np.asarray(samples.values)[:, 0]
                without += int(np.count_nonzero(np.isnan(values)))
                file.writelines(each + b"\n" for each in numbers(values))
    rates = [run.rate_hz(stream.header.rate) for run in runs]
    if rates:
        told = ", ".join(f"{rate:.6g}" for rate in dict.fromkeys(rates[:3]))
        more = ", ..." if len(rates) > 3 else ""
        yield f"{name}: tell Kubios its rate, {told}{more} Hz, and its unit, {_unit(stream)}"
    if without:
        yield f"{name}: {without} samples have no value and are NaN"
    if len(runs) > 1:
        yield f"{name}: its gaps cut it into {len(runs)} files"


def _unit(stream: Stream) -> str:
    return stream.meaning.units[0] or "not known"
