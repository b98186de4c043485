"""Writes EEG as BIDS wants it: BrainVision files in ``eeg``, with channels and events of their own.

Samples stand on a grid of equal steps. Behind a short gap the file goes on, with NaN where nothing
was measured and an event ``BAD_gap``, which MNE leaves out; behind a long one another run begins.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.bids import sidecars
from biosensor_gateway.recording.export.bids.brain_vision import (
    BinaryRows,
    is_small,
    write_header,
)
from biosensor_gateway.recording.export.bids.file_names import Entities
from biosensor_gateway.recording.export.bids.regular import RegularTable, fill
from biosensor_gateway.recording.export.bids.tables import NOTHING, write_json, write_rows
from biosensor_gateway.recording.export.bids.timing import Part, Timing
from biosensor_gateway.recording.export.timeline import Timeline

EEG = "eeg"
LONGEST_FILLED_S = 10.0
"""Behind a longer gap another run begins."""
_HEAD = ("name", "type", "units", "sampling_frequency", "description")
# Types of channels that BIDS knows.
_TYPES = frozenset({
    "ACCEL", "AUDIO", "EEG", "EOG", "ECG", "EMG", "EYEGAZE", "GSR", "HEOG", "MISC", "PPG", "PUPIL",
    "REF", "RESP", "SYSCLOCK", "TEMP", "TRIG", "VEOG",
})  # fmt: skip
_COUNTED = {
    "EEG": "EEG",
    "EOG": "EOG",
    "ECG": "ECG",
    "EMG": "EMG",
    "MISC": "Misc",
    "TRIG": "Trigger",
}


@dataclass(frozen=True, slots=True)
class EegFile:
    """One run of EEG.

    Attributes
    ----------
    entities
        What its files are called.
    start_s
        Time of the first row, since zero.
    gaps
        First row and number of the rows without samples.
    """

    stream: Stream
    entities: Entities
    start_s: float
    rate_hz: float
    rows: int
    gaps: tuple[tuple[int, int], ...]

    def path(self, suffix: str) -> Path:
        """Return the path of one of its files below the dataset's root."""
        return self.entities.path(EEG, suffix)


def is_eeg(stream: Stream) -> bool:
    """Whether a stream is EEG, by its type."""
    return stream.header.content_type.lower() == "eeg" and stream.header.is_regular


def run_of(entities: Entities, number: int, runs: int) -> Entities:
    """Return the names of one of several runs of a recording, which may be a run itself."""
    if runs == 1:
        return entities
    return replace(entities, run=f"{entities.run}{number:0{len(str(runs)) + 1}d}")


def write_eeg(
    root: Path,
    stream: Stream,
    entities: Entities,
    samples: Iterator[Samples],
    part: Part,
    rate_hz: float,
) -> tuple[EegFile, RegularTable]:
    """Write samples and header of one run.

    Parameters
    ----------
    samples
        Those of the run, with seconds since zero.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    path = root / entities.path(EEG, "eeg.eeg")
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("x+b") as file:
        rows = BinaryRows(file, is_small=is_small(stream))
        grid = fill(rows, samples, part, rate_hz)
    write_header(path.with_suffix(".vhdr"), stream, names_of(stream), rows.kind, rate_hz)
    start_s = part.start_s + grid.first_row / rate_hz
    table = RegularTable(
        path,
        start_s,
        grid.samples,
        rows.rows - grid.samples,
        grid.displacement.largest / rate_hz,
        grid.displacement.moved,
    )
    return EegFile(stream, entities, start_s, rate_hz, rows.rows, tuple(rows.empty)), table


def names_of(stream: Stream) -> list[str]:
    """Return the names of the channels."""
    return sidecars.columns(stream)


def describe(
    root: Path, file: EegFile, timing: Timing, table: RegularTable, timeline: Timeline
) -> None:
    """Write what belongs to a run but its events."""
    stream = file.stream
    types = [_type(each) for each in sidecars.channel_types(stream)]
    told = zip(names_of(stream), types, stream.meaning.units, stream.header.labels, strict=True)
    rate = f"{file.rate_hz:.12g}"
    rows = [
        (name, kind, sidecars.unit(unit), rate, f"{label} of {stream.header.name}")
        for name, kind, unit, label in told
    ]
    write_rows(root / file.path("channels.tsv"), [_HEAD, *rows])
    counts = {f"{name}ChannelCount": types.count(kind) for kind, name in _COUNTED.items()}
    content = {
        "TaskName": file.entities.task,
        # No header tells these; who knows them puts them in.
        "EEGReference": NOTHING,
        "PowerLineFrequency": NOTHING,
        "SoftwareFilters": NOTHING,
        "SamplingFrequency": file.rate_hz,
        "RecordingDuration": file.rows / file.rate_hz,
        "RecordingType": "discontinuous" if file.gaps else "continuous",
        **counts,
        **sidecars.of_grid(stream, timing, table),
        **sidecars.of_stream(stream, timeline),
    }
    write_json(root / file.path("eeg.json"), content)


def _type(told: str) -> str:
    return told.upper() if told.upper() in _TYPES else "MISC" if told else "EEG"


def gap_events(file: EegFile) -> Iterator[tuple[float, float, str]]:
    """Give onset and duration, in s since the run's first row, of each gap in it, and a text."""
    for row, count in file.gaps:
        text = f"{count} samples are missing"
        yield row / file.rate_hz, count / file.rate_hz, text


def runs_by_start(files: Sequence[EegFile]) -> dict[int, list[EegFile]]:
    """Return the runs of each stream, by its number, in the order of time."""
    found: dict[int, list[EegFile]] = {}
    for file in sorted(files, key=lambda each: each.start_s):
        found.setdefault(file.stream.number, []).append(file)
    return found
