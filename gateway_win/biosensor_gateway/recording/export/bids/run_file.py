"""The EEG and EMG files of a run, with their channels and events."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.bids import sidecars
from biosensor_gateway.recording.export.bids.file_names import Entities
from biosensor_gateway.recording.export.bids.tables import NOTHING, write_rows

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
    """One run of EEG or EMG.

    Attributes
    ----------
    datatype
        The folder, ``eeg`` or ``emg``, which is also the suffix of its file.
    entities, recording
        Parts of its file names; `recording` is empty if not needed to distinguish files.
    start_s
        Time of the first row since zero.
    gaps
        First row and number of rows of each gap.
    without
        Onset and duration of other missing values, in s since the first row, with a description.
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
            (name, kind, unit, rate, f"{label} of {stream.header.name}")
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
