"""Writes one numeric stream: its tables and their descriptions."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_common.quantities import ACCELERATION, MAGNETIC_FIELD, ORIENTATION
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.bids import sidecars
from biosensor_gateway.recording.export.bids.brain_vision import is_exact as has_exact_numbers
from biosensor_gateway.recording.export.bids.file_names import (
    NOTHING,
    Entities,
    Kind,
    kind_of,
    motion_type,
    write_json,
    write_rows,
)
from biosensor_gateway.recording.export.bids.gaze import Eye, eyes_of
from biosensor_gateway.recording.export.bids.regular import (
    RegularTable,
    parts_of,
    write_regular,
)
from biosensor_gateway.recording.export.bids.run_file import (
    LONGEST_FILLED_S,
    RunFile,
    describe_eeg,
    run_of,
    write_eeg,
    write_emg,
)
from biosensor_gateway.recording.export.bids.sidecars import (
    DURATION,
    ONSET,
    TIMESTAMP,
    channel_types,
    columns,
    unit,
)
from biosensor_gateway.recording.export.exporter import ExportOptions, SampleCount, Timeline, Times
from biosensor_gateway.recording.export.runs import (
    BAD_GAP,
    LONGEST_JOINED_S,
    Gap,
    Runs,
    batches,
    gap_text,
    on_line,
    section,
)
from biosensor_gateway.recording.export.tables import rows_of_numbers, table_file
from biosensor_gateway.recording.export.time_axis import Timing, find_timing
from biosensor_gateway.recording.xdf.figures import cuts_of
from biosensor_gateway.recording.xdf.pace import Cuts

_BY_ROLE = {
    **dict.fromkeys(ACCELERATION, "ACCEL"),
    **dict.fromkeys(MAGNETIC_FIELD, "MAGN"),
    **dict.fromkeys(ORIENTATION, "ORNT"),
}
# Channel types of other programs: PositionX, OrientationW, accx, Gyro Y ...
_TOLD = re.compile(r"(pos|ori|quat|acc|gyr|mag|vel)[a-z]*[ _.-]?([wxyz])", re.IGNORECASE)
_BY_WORD = {
    "pos": "POS",
    "ori": "ORNT",
    "quat": "ORNT",
    "acc": "ACCEL",
    "gyr": "GYRO",
    "mag": "MAGN",
    "vel": "VEL",
}
_MOTION_HEAD = ("name", "component", "type", "tracked_point", "units")
LATENCY = "LATENCY"
_MOTION_CHANNEL_TYPES = (
    "ACCEL", "ANGACCEL", "GYRO", "JNTANG", LATENCY, "MAGN", "MISC", "ORNT", "POS", "VEL",
)  # fmt: skip


class Channel(NamedTuple):
    """A row of ``channels.tsv``."""

    name: str
    component: str
    type: str
    tracked_point: str
    units: str


def motion_channels(stream: Stream) -> list[Channel]:
    """Return the channels of a motion table; the first is the time of the samples."""
    meaning = stream.meaning
    point = meaning.identity.label or meaning.identity.sensor
    usual = motion_type(stream)
    told = zip(
        columns(stream),
        stream.header.labels,
        channel_types(stream),
        meaning.roles,
        meaning.units,
        strict=True,
    )
    found = [Channel(TIMESTAMP, NOTHING, LATENCY, NOTHING, "s")]
    for name, label, channel_type, role, unit_name in told:
        if role is not None and role in _BY_ROLE:
            kind, axis = _BY_ROLE[role], role.value[-1]
        else:
            kind, axis = _kind(usual, label, channel_type)
        component = f"quat_{axis}" if kind == "ORNT" and axis else axis
        found.append(Channel(name, component, kind, point, unit(unit_name)))
    return found


def _kind(usual: str, label: str, channel_type: str) -> tuple[str, str]:
    """Return type and axis of a channel without a role; the axis is empty if unknown."""
    for text in (channel_type, label):
        if match := _TOLD.fullmatch(text):
            kind, axis = _BY_WORD[match[1].lower()], match[2].lower()
            return (kind, axis) if axis != "w" or kind == "ORNT" else (kind, "")
    is_axis = label.lower() in ("x", "y", "z") and usual != "MISC"
    return usual, label.lower() if is_axis else ""


def _channel_counts(found: Sequence[Channel]) -> dict[str, int]:
    """Return the numbers of channels for ``motion.json``."""
    by_type = Counter(each.type for each in found)
    return {
        **{f"{kind}ChannelCount": by_type[kind] for kind in _MOTION_CHANNEL_TYPES},
        "MotionChannelCount": len(found),
        "TrackedPointsCount": 1,
    }


BEHAVIOUR, MOTION = "beh", "motion"
# Timestamps further from zero are not valid times.
_FURTHEST_S = 4e9
_MOST_PARTS = 100
# A stream that consists mostly of gaps does not become a table with a fixed rate.
_MOST_EMPTY_PER_SAMPLE = 100
_ALWAYS_EMPTY_S = 24 * 3600.0
_MICROSECONDS = 6


@dataclass(frozen=True, slots=True)
class Place:
    """The place of a stream's files; `label` distinguishes it from the participant's others."""

    entities: Entities
    label: str
    is_one_of_several: bool = False


@dataclass(slots=True)
class Remarks:
    """Names of streams for notes to the user."""

    without_samples: list[str] = field(default_factory=list[str])
    without_table: list[str] = field(default_factory=list[str])
    cut: list[str] = field(default_factory=list[str])
    runs: list[str] = field(default_factory=list[str])
    rounded: list[str] = field(default_factory=list[str])
    moved: list[str] = field(default_factory=list[str])
    in_24_bits: list[str] = field(default_factory=list[str])
    sentences: list[str] = field(default_factory=list[str])
    """Sentences about the handling of timestamps and gaps."""
    unplaced: int = 0
    """Number of samples with invalid times."""


class SignalWriter:
    """Writes numeric streams."""

    def __init__(
        self,
        chosen: Chosen,
        options: ExportOptions,
        timeline: Timeline,
        root: Path,
        count: SampleCount,
    ) -> None:
        self._chosen, self._options, self._times = chosen, options, options.times
        self._timeline = timeline
        self._root = root
        self._count = count
        self.remarks = Remarks()
        self.runs: list[RunFile] = []
        """Runs of EEG and EMG written so far."""
        self.gaps: list[tuple[Stream, Gap]] = []
        """Gaps in tables with even times."""

    def write(self, stream: Stream, place: Place) -> bool:
        """Write a stream; return whether a table was written.

        Raises
        ------
        OSError
            If a file cannot be written.
        """
        if stream.header.is_regular:
            return self._write_regular(stream, place)
        if next(self._batches(stream), None) is None:
            self.remarks.without_samples.append(stream.header.title)
            return False
        self._write_irregular(stream, place)
        return True

    def _batches(
        self, stream: Stream, runs: Runs | None = None, *, is_first: bool = False
    ) -> Iterator[Samples]:
        """Yield samples in seconds since zero; on the first pass, count those left out."""
        for samples in batches(self._chosen, stream) if runs is None else runs.samples():
            near = samples.picked(np.abs(samples.times - self._timeline.zero_s) < _FURTHEST_S)
            if is_first:
                self.remarks.unplaced += len(samples) - len(near)
            if len(near):
                times = self._timeline.since_zero(near.times)
                yield Samples(times, near.stamps, near.values)

    def _counted(self, parts: Iterator[Samples]) -> Iterator[Samples]:
        for samples in parts:
            yield samples
            self._count.add(len(samples))

    def _write_irregular(self, stream: Stream, place: Place) -> None:
        entities, recording = place.entities, {"recording": place.label}
        table = self._root / entities.path(BEHAVIOUR, "physioevents.tsv.gz", **recording)
        table.parent.mkdir(parents=True, exist_ok=True)
        samples = write_irregular(table, self._counted(self._batches(stream, is_first=True)))
        content = {
            "Description": f"the stream {stream.header.title}, which has no rate",
            "Columns": [ONSET, DURATION, *sidecars.columns(stream)],
            # Onsets do not refer to another table's column but are seconds since TimeZero.
            "OnsetSource": "",
            ONSET: {"Description": "time of the sample, since TimeZero", "Units": "s"},
            DURATION: {"Description": "0: a sample applies to an instant", "Units": "s"},
            **sidecars.described_columns(stream),
            "TaskName": entities.task,
            "Samples": samples,
            **sidecars.of_stream(stream, self._timeline),
        }
        path = self._root / entities.path(BEHAVIOUR, "physioevents.json", **recording)
        write_json(path, content)

    def _write_eeg(
        self, stream: Stream, place: Place, cuts: Cuts | None, runs: Runs | None
    ) -> bool:
        """Write an EEG stream; return False if it must become a table instead."""
        longest_s = LONGEST_JOINED_S if self._times is Times.EVEN else LONGEST_FILLED_S
        timing = find_timing(
            (each.times for each in self._batches(stream, runs)), stream.header, cuts, longest_s
        )
        if timing is None or len(timing.parts) > _MOST_PARTS:
            return False
        moved = 0
        label = place.label if place.is_one_of_several else ""
        acquisition = f"{place.entities.acquisition}{label}"
        entities = replace(place.entities, acquisition=acquisition)
        parts = parts_of(self._batches(stream, runs), timing.parts)
        for number, (part, batched) in enumerate(zip(timing.parts, parts, strict=True), 1):
            run = run_of(entities, number, len(timing.parts))
            file, table = write_eeg(
                self._root, stream, run, self._counted(batched), part, timing.rate_hz
            )
            describe_eeg(self._root, file, timing, table, self._timeline)
            self.runs.append(file)
            moved += table.moved
        if len(timing.parts) > 1:
            self.remarks.runs.append(stream.header.title)
        if moved:
            self.remarks.moved.append(stream.header.title)
        if not has_exact_numbers(stream):
            self.remarks.rounded.append(stream.header.title)
        return True

    def _write_emg(self, stream: Stream, place: Place) -> bool:
        """Write an EMG stream; return False if it must become a table instead."""
        files, notes = write_emg(
            self._root,
            self._chosen,
            self._options,
            stream,
            place.entities,
            place.label,
            self._timeline,
        )
        self.runs += files
        self.remarks.sentences += [f"{stream.header.title}: {each}" for each in notes]
        if files:
            self._count.add(stream.sample_count)
            self.remarks.in_24_bits.append(stream.header.title)
        return bool(files)

    def _write_regular(self, stream: Stream, place: Place) -> bool:
        kind = kind_of(stream)
        if kind is Kind.EMG and self._write_emg(stream, place):
            return True
        is_eeg = kind is Kind.EEG
        runs, cuts = on_line(self._chosen, stream, self._times, always=is_eeg)
        if is_eeg and self._write_eeg(stream, place, cuts, runs):
            self._remark(stream, runs)
            return True
        if runs is not None and self._times is not Times.EVEN and not runs.is_uneven:
            runs = None
        if runs is None and cuts is not None and (cuts.stray or stream.part_error):
            # A table leaves out samples far from all others, so that others have their numbers.
            times = (each.times for each in self._batches(stream))
            cuts = cuts_of(times, stream.header, section(self._chosen))
        return self._write_table(stream, place, cuts, runs)

    def _write_table(
        self, stream: Stream, place: Place, cuts: Cuts | None, runs: Runs | None
    ) -> bool:
        """Write the tables of a stream; return whether there are any."""
        name = stream.header.title
        first = self._batches(stream, runs, is_first=True)
        timing = find_timing((each.times for each in first), stream.header, cuts)
        if timing is None:
            self.remarks.without_samples.append(name)
            return False
        samples = sum(part.count for part in timing.parts)
        most = samples * _MOST_EMPTY_PER_SAMPLE + _ALWAYS_EMPTY_S * timing.rate_hz
        if len(timing.parts) > _MOST_PARTS or timing.rows > most:
            self.remarks.without_table.append(name)
            return False
        moved = 0
        for number, eye in enumerate(self._eyes_of(stream) or [None], 1):
            label = place.label if eye is None else f"eye{number}"
            if eye is not None and place.is_one_of_several:
                label = f"{place.label}{label}"
            moved += self._write_parts(stream, replace(place, label=label), timing, runs, eye)
        if len(timing.parts) > 1:
            self.remarks.cut.append(name)
        if moved:
            self.remarks.moved.append(name)
        if runs is not None:
            self.gaps += [(stream, each) for each in runs.gaps()]
            self._remark(stream, runs)
        return True

    def _write_parts(
        self, stream: Stream, place: Place, timing: Timing, runs: Runs | None, eye: Eye | None
    ) -> int:
        """Write a table for each part; return how many samples are not in their own row."""
        moved = 0
        parts = parts_of(self._batches(stream, runs), timing.parts)
        for number, (part, batched) in enumerate(zip(timing.parts, parts, strict=True), 1):
            # Labels of streams never contain a plus.
            label = f"{place.label}+part{number}" if len(timing.parts) > 1 else place.label
            files = _Files(self._root, Place(place.entities, label), kind_of(stream) is Kind.MOTION)
            files.table.parent.mkdir(parents=True, exist_ok=True)
            given = self._counted(batched)
            given = given if eye is None else eye.picked(given)
            table = write_regular(files.table, given, part, timing.rate_hz)
            files.describe(stream, timing, table, self._timeline, eye)
            moved += table.moved
        return moved

    def _eyes_of(self, stream: Stream) -> list[Eye]:
        """Return the eyes of a gaze stream; note what its header does not specify."""
        if kind_of(stream) is not Kind.GAZE:
            return []
        eyes, told = eyes_of(stream), ""
        if not eyes:
            told = (
                "no channels are known to be x and y of the gaze, so it is a table like any other"
            )
        elif not all(each.is_told for each in eyes):
            told = "no header says which eye it is, so it is called cyclopean, which means both"
        if told:
            self.remarks.sentences.append(f"{stream.header.title}: {told}")
        return eyes

    def _remark(self, stream: Stream, runs: Runs | None) -> None:
        """Note how timestamps were changed to even times."""
        if runs is None:
            return
        name = stream.header.title
        self.remarks.sentences += [f"{name}: {told}" for told in runs.remarks_on_times()]
        if gaps := runs.gaps():
            told = gap_text([each.lost for each in gaps])
            self.remarks.sentences.append(
                f"{name}: {told}, each an event {BAD_GAP} or the end of a run"
            )


class _Files:
    """The files of a regular table."""

    def __init__(self, root: Path, place: Place, is_motion: bool) -> None:
        self._root = root
        self._place = place
        self._is_motion = is_motion
        self.table = self._path("motion.tsv" if is_motion else "physio.tsv.gz")

    def _path(self, suffix: str) -> Path:
        datatype, key = (MOTION, "tracksys") if self._is_motion else (BEHAVIOUR, "recording")
        return self._root / self._place.entities.path(datatype, suffix, **{key: self._place.label})

    def describe(
        self,
        stream: Stream,
        timing: Timing,
        table: RegularTable,
        timeline: Timeline,
        eye: Eye | None,
    ) -> None:
        """Write the sidecar of the table, which may be of one eye only."""
        names = sidecars.columns(stream) if eye is None else eye.names
        is_motion = self._is_motion
        columns = sidecars.described_columns(stream) if eye is None else eye.described(stream)
        content = {
            "TaskName": self._place.entities.task,
            **(self._of_motion(stream, timing) if is_motion else _of_physio(timing, names)),
            **sidecars.of_grid(stream, timing, table),
            **sidecars.of_stream(stream, timeline),
            **sidecars.timestamp(),
            **columns,
        }
        write_json(self._path("motion.json" if self._is_motion else "physio.json"), content)

    def _of_motion(self, stream: Stream, timing: Timing) -> dict[str, object]:
        channels = motion_channels(stream)
        write_rows(self._path("channels.tsv"), [_MOTION_HEAD, *channels])
        return {
            "TrackingSystemName": stream.meaning.identity.sensor,
            # For motion, BIDS wants the nominal rate here, and the real one in a separate key.
            "SamplingFrequency": stream.header.rate,
            "SamplingFrequencyEffective": timing.rate_hz,
            "MissingValues": "n/a",
            **_channel_counts(channels),
        }


def _of_physio(timing: Timing, names: Sequence[str]) -> dict[str, object]:
    return {
        "SamplingFrequency": timing.rate_hz,
        "Columns": [TIMESTAMP, *names],
        "PhysioType": "generic",
    }


def write_irregular(path: Path, batches: Iterator[Samples]) -> int:
    """Write onset, duration and values of each sample, in the order of the recording.

    Parameters
    ----------
    batches
        With times in seconds since zero.

    Returns
    -------
    int
        Number of samples.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    written = 0
    with table_file(path, is_packed=True) as file:
        for samples in batches:
            file.write(_text(samples.times, np.asarray(samples.values)))
            written += len(samples)
    return written


def _text(times: NDArray[np.float64], values: NDArray[np.generic]) -> bytes:
    text = rows_of_numbers(np.round(times, _MICROSECONDS), values)
    lines = text.replace(b"NaN", NOTHING.encode()).splitlines()
    # The duration is 0, since each sample is one moment.
    rows = (line.partition(b",") for line in lines)
    return b"".join(onset + b"\t0\t" + rest.replace(b",", b"\t") + b"\n" for onset, _, rest in rows)
