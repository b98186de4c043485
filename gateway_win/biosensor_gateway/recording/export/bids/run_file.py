"""The EEG (BrainVision) and EMG (BDF+) files of a run in BIDS, with their channels and events."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.bids import sidecars
from biosensor_gateway.recording.export.bids.brain_vision import (
    BinaryRows,
    is_small,
    write_header,
)
from biosensor_gateway.recording.export.bids.file_names import (
    NOTHING,
    Entities,
    write_json,
    write_rows,
)
from biosensor_gateway.recording.export.bids.regular import RegularTable, fill
from biosensor_gateway.recording.export.edf.bdf import RATES_HZ, Channel
from biosensor_gateway.recording.export.edf.edf_exporter import (
    INSTEAD,
    Given,
    Holes,
    channels_of,
    write_stretch,
)
from biosensor_gateway.recording.export.exporter import ExportOptions, Timeline, Times
from biosensor_gateway.recording.export.runs import (
    LONGEST_JOINED_S,
    Runs,
    Stretch,
    stretches,
)
from biosensor_gateway.recording.export.time_axis import Part, Timing

LONGEST_FILLED_S = 10.0
"""A longer gap starts a new run."""
_HEAD = ("name", "type", "units", "sampling_frequency", "description")
# Channel types defined by BIDS.
_TYPES = frozenset({
    "ACCEL", "AUDIO", "EEG", "EOG", "ECG", "EMG", "EYEGAZE", "GSR", "HEOG", "MISC", "PPG", "PUPIL",
    "REF", "RESP", "SYSCLOCK", "TEMP", "TRIG", "VEOG",
})  # fmt: skip


@dataclass(frozen=True, slots=True)
class RunFile:
    """One run of EEG or EMG."""

    datatype: str  # The folder, `eeg` or `emg`, which is also the suffix of its file.
    stream: Stream
    # entities, recording: parts of its file names; `recording` is empty if not needed to
    # distinguish files.
    entities: Entities
    recording: str
    start_s: float  # Time of the first row since zero.
    rate_hz: float
    rows: int
    gaps: tuple[tuple[int, int], ...]  # First row and number of rows of each gap.
    # Onset and duration of other missing values, in s since the first row, with a description.
    without: tuple[tuple[float, float, str], ...] = ()

    def path(self, suffix: str) -> Path:
        """Return the path of one of its files relative to the dataset's root."""
        return self.entities.path(self.datatype, suffix, recording=self.recording)

    def gap_events(self) -> Iterator[tuple[float, float, str]]:
        """Yield onset and duration of each gap, in s since the first row, with a text."""
        for row, count in self.gaps:
            yield row / self.rate_hz, count / self.rate_hz, f"{count} samples are missing"

    def write_channels(self, root: Path, names: Sequence[str], units: Sequence[str]) -> list[str]:
        """Write the table of channels; return the channel types.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        usual, stream = self.datatype.upper(), self.stream
        types = [_type(each, usual) for each in sidecars.channel_types(stream)]
        told = zip(names, types, units, stream.header.labels, strict=True)
        rate = f"{self.rate_hz:.12g}"
        rows = [
            (name, kind, unit, rate, f"{label} of {stream.header.title}")
            for name, kind, unit, label in told
        ]
        write_rows(root / self.path("channels.tsv"), [_HEAD, *rows])
        return types

    def described(self) -> dict[str, object]:
        """Return the sidecar entries common to EEG and EMG."""
        return {
            "TaskName": self.entities.task,
            # Not contained in LSL headers; the user must fill them in.
            "PowerLineFrequency": NOTHING,
            "SoftwareFilters": NOTHING,
            "SamplingFrequency": self.rate_hz,
            "RecordingDuration": self.rows / self.rate_hz,
            "RecordingType": "discontinuous" if self.gaps else "continuous",
        }


def _type(told: str, usual: str) -> str:
    return told.upper() if told.upper() in _TYPES else "MISC" if told else usual


def run_of(entities: Entities, number: int, runs: int) -> Entities:
    """Return the entities of one of several runs of a recording, which may be a run itself."""
    if runs == 1:
        return entities
    return replace(entities, run=f"{entities.run}{number:0{len(str(runs)) + 1}d}")


def runs_by_start(files: Sequence[RunFile]) -> dict[int, list[RunFile]]:
    """Return the runs of each stream by stream number, in time order."""
    found: dict[int, list[RunFile]] = {}
    for file in sorted(files, key=lambda each: each.start_s):
        found.setdefault(file.stream.number, []).append(file)
    return found


_EEG = "eeg"
_COUNTED = {
    "EEG": "EEG",
    "EOG": "EOG",
    "ECG": "ECG",
    "EMG": "EMG",
    "MISC": "Misc",
    "TRIG": "Trigger",
}


# Samples are placed on an evenly spaced grid. After a short gap the file continues, with NaN in the
# gap and an event ``BAD_gap``, which MNE excludes; a long gap starts a new run.
def write_eeg(
    root: Path,
    stream: Stream,
    entities: Entities,
    samples: Iterator[Samples],
    part: Part,
    rate_hz: float,
) -> tuple[RunFile, RegularTable]:
    """Write samples and header of one run.

    Parameters
    ----------
    samples
        Samples of the run, with times in seconds since zero.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    path = root / entities.path(_EEG, "eeg.eeg")
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("x+b") as file:
        rows = BinaryRows(file, is_small=is_small(stream))
        grid = fill(rows, samples, part, rate_hz)
    write_header(path.with_suffix(".vhdr"), stream, sidecars.columns(stream), rows.kind, rate_hz)
    start_s = part.start_s + grid.first_row / rate_hz
    table = RegularTable(
        path,
        start_s,
        grid.samples,
        rows.rows - grid.samples,
        grid.displacement.largest / rate_hz,
        grid.displacement.moved,
    )
    file = RunFile(_EEG, stream, entities, "", start_s, rate_hz, rows.rows, tuple(rows.empty))
    return file, table


def describe_eeg(
    root: Path, file: RunFile, timing: Timing, table: RegularTable, timeline: Timeline
) -> None:
    """Write the sidecar files of a run, except its events."""
    stream = file.stream
    units = [sidecars.unit(each) for each in stream.meaning.units]
    types = file.write_channels(root, sidecars.columns(stream), units)
    counts = {f"{name}ChannelCount": types.count(kind) for kind, name in _COUNTED.items()}
    content = {
        **file.described(),
        "EEGReference": NOTHING,
        **counts,
        **sidecars.of_grid(stream, timing, table),
        **sidecars.of_stream(stream, timeline),
    }
    write_json(root / file.path("eeg.json"), content)


_EMG = "emg"


# Numbers have 24 bits. As with EEG, a file continues after a short gap, and a long gap starts a new
# run. BDF has no missing values, so the minimum is written instead, with events at these places.
def write_emg(
    root: Path,
    chosen: Chosen,
    options: ExportOptions,
    stream: Stream,
    entities: Entities,
    label: str,
    timeline: Timeline,
) -> tuple[list[RunFile], list[str]]:
    """Write an EMG stream; return its runs, none if it does not fit BDF, and notes for the user.

    Parameters
    ----------
    label
        Distinguishes the stream from the participant's others.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    is_even = options.times is Times.EVEN or not stream.header.has_exact_stamps
    cut = Runs(chosen, stream, Times.EVEN if is_even else Times.RECORDED)
    runs = cut.found()
    longest_s = LONGEST_JOINED_S if options.times is Times.EVEN else LONGEST_FILLED_S
    every = stretches(runs, stream.header.rate, longest_s)
    if not runs or cut.left_out(len(runs), len(every)):
        return [], []
    held = [_held(stream, each) for each in every]
    if not all(held):
        return [], []
    holes = Holes(stream, [each.begin_s for each in every for _ in each.runs])
    for number, samples in cut.pieces():
        holes.take(number, samples)
    notes = [*cut.remarks(every, INSTEAD), *holes.notes()]
    given, files = Given(cut), list[RunFile]()
    for number, (stretch, channels) in enumerate(zip(every, held, strict=True), 1):
        numbers = range(stretch.first, stretch.first + len(stretch.runs))
        missing = [each for at in numbers for each in holes.found[at]]
        (start_s,) = timeline.since_zero(np.array([stretch.begin_s])).tolist()
        file = RunFile(
            _EMG,
            stream,
            run_of(entities, number, len(every)),
            label,
            start_s,
            stretch.rate_hz,
            stretch.rows,
            tuple(stretch.gaps),
            tuple((each.begin_s, each.length_s, each.text) for each in missing),
        )
        path = root / file.path("emg.bdf")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_stretch(chosen, options.clock, stream, stretch, channels, missing, given, path)
        _describe(root, file, stretch, channels, timeline)
        files.append(file)
    return files, notes


def _held(stream: Stream, stretch: Stretch) -> list[Channel]:
    """Return the channels for BDF; none if a channel or the rate does not fit."""
    channels, without = channels_of(stream, stretch)
    is_held = not without and RATES_HZ[0] <= stretch.rate_hz <= RATES_HZ[1]
    return channels if is_held else []


def _describe(
    root: Path, file: RunFile, stretch: Stretch, channels: list[Channel], timeline: Timeline
) -> None:
    names = [each.label for each in channels]
    types = file.write_channels(root, names, [each.dimension or NOTHING for each in channels])
    samples = sum(each.count for each in stretch.runs)
    content = {
        **file.described(),
        "EMGPlacementScheme": "Other",
        "EMGPlacementSchemeDescription": "unknown, because no header has it; please fill it in",
        "EMGReference": NOTHING,
        "EMGChannelCount": types.count("EMG"),
        "StartTime": round(file.start_s, 6),
        "SamplingFrequencyNominal": file.stream.header.rate,
        "Samples": samples,
        "EmptyRows": stretch.rows - samples,
        "Gaps": len(file.gaps),
        **sidecars.of_stream(file.stream, timeline),
    }
    write_json(root / file.path("emg.json"), content)
