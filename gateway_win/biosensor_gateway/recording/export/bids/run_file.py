"""The files of EEG and EMG: one for each run, in a folder of its kind, with channels and events."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.bids import sidecars
from biosensor_gateway.recording.export.bids.file_names import Entities
from biosensor_gateway.recording.export.bids.tables import NOTHING, write_rows

LONGEST_FILLED_S = 10.0
"""Behind a longer gap another run begins."""
_HEAD = ("name", "type", "units", "sampling_frequency", "description")
# Types of channels that BIDS knows.
_TYPES = frozenset({
    "ACCEL", "AUDIO", "EEG", "EOG", "ECG", "EMG", "EYEGAZE", "GSR", "HEOG", "MISC", "PPG", "PUPIL",
    "REF", "RESP", "SYSCLOCK", "TEMP", "TRIG", "VEOG",
})  # fmt: skip


@dataclass(frozen=True, slots=True)
class RunFile:
    """One run of EEG or EMG.

    Attributes
    ----------
    datatype
        The folder, ``eeg`` or ``emg``, which is also what its file is called.
    entities, recording
        What its files are called; `recording` is empty where that does not tell it from others.
    start_s
        Time of the first row, since zero.
    gaps
        First row and number of the rows without samples.
    without
        Onset and duration, in s since the first row, of other places without a value, in words.
    """

    datatype: str
    stream: Stream
    entities: Entities
    recording: str
    start_s: float
    rate_hz: float
    rows: int
    gaps: tuple[tuple[int, int], ...]
    without: tuple[tuple[float, float, str], ...] = ()

    def path(self, suffix: str) -> Path:
        """Return the path of one of its files below the dataset's root."""
        return self.entities.path(self.datatype, suffix, recording=self.recording)

    def gap_events(self) -> Iterator[tuple[float, float, str]]:
        """Give onset and duration, in s since the first row, of each gap in it, and a text."""
        for row, count in self.gaps:
            yield row / self.rate_hz, count / self.rate_hz, f"{count} samples are missing"

    def write_channels(self, root: Path, names: Sequence[str], units: Sequence[str]) -> list[str]:
        """Write the table of channels; return their types.

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
            (name, kind, unit, rate, f"{label} of {stream.header.name}")
            for name, kind, unit, label in told
        ]
        write_rows(root / self.path("channels.tsv"), [_HEAD, *rows])
        return types

    def described(self) -> dict[str, object]:
        """Return what a sidecar says of any such run."""
        return {
            "TaskName": self.entities.task,
            # No header tells these; who knows them puts them in.
            "PowerLineFrequency": NOTHING,
            "SoftwareFilters": NOTHING,
            "SamplingFrequency": self.rate_hz,
            "RecordingDuration": self.rows / self.rate_hz,
            "RecordingType": "discontinuous" if self.gaps else "continuous",
        }


def _type(told: str, usual: str) -> str:
    return told.upper() if told.upper() in _TYPES else "MISC" if told else usual


def run_of(entities: Entities, number: int, runs: int) -> Entities:
    """Return the names of one of several runs of a recording, which may be a run itself."""
    if runs == 1:
        return entities
    return replace(entities, run=f"{entities.run}{number:0{len(str(runs)) + 1}d}")


def runs_by_start(files: Sequence[RunFile]) -> dict[int, list[RunFile]]:
    """Return the runs of each stream, by its number, in the order of time."""
    found: dict[int, list[RunFile]] = {}
    for file in sorted(files, key=lambda each: each.start_s):
        found.setdefault(file.stream.number, []).append(file)
    return found
