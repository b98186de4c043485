"""Writes the events of all marker streams as a table for each participant."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.bids.brain_vision import write_markers
from biosensor_gateway.recording.export.bids.run_file import RunFile, runs_by_start
from biosensor_gateway.recording.export.bids.tables import NOTHING, line, write_json, write_text
from biosensor_gateway.recording.export.marker_events import MarkerEvent, in_order
from biosensor_gateway.recording.export.runs import BAD_GAP

BAD_VALUE = "BAD_value"
"""Event for a missing value in a format that has no missing values."""
COLUMNS = ("onset", "duration", "trial_type", "undone", "stream", "note", "value")
COLUMN_DESCRIPTIONS: Mapping[str, object] = {
    "onset": {"Description": "time since TimeZero", "Units": "s"},
    "duration": {"Description": "of a gap; not known else, as markers are moments", "Units": "s"},
    "trial_type": {"Description": "name of the marker or of a device's event, or a short text"},
    "undone": {"Description": "yes where the experimenter took the marker back later, else no"},
    "stream": {"Description": "name of the LSL stream"},
    "note": {"Description": "free text of a marker of the experimenter"},
    "value": {"Description": "the whole text as it was recorded"},
}
Holds = Mapping[int, Iterable[str]]
"""The participants' labels of each marker stream, by stream number."""


class Events:
    """Tables of events; each is created with its first event.

    Parameters
    ----------
    paths
        File of each participant by label.
    participants
        Recorded name of each participant by label.
    """

    def __init__(self, paths: Mapping[str, Path], participants: Mapping[str, str]) -> None:
        self._paths = paths
        self._participants = participants
        self._stack = ExitStack()
        self._files: dict[str, TextIO] = {}
        self.counts: Counter[str] = Counter()
        """Number of rows by label."""
        self.kept: dict[str, list[tuple[Stream, MarkerEvent]]] = {}
        """Events of the participants in it, by label."""

    def write(
        self,
        events: Iterable[tuple[Stream, MarkerEvent]],
        gaps: Iterable[tuple[Stream, MarkerEvent]],
        holds: Holds,
    ) -> None:
        """Write all events in time order.

        Parameters
        ----------
        events
            Roughly in time order.
        gaps
            Gaps in tables; EEG has its own.
        holds
            Participants' labels of each stream, by stream number.

        Raises
        ------
        OSError
            If a table cannot be written.
        """
        with self._stack:
            for stream, event in in_order(events, gaps):
                for label in holds[stream.number]:
                    if event.participant in ("", self._participants[label]):
                        self._file(label).write(_row(stream, event))
                        self.counts[label] += 1
                        if label in self.kept and event.duration_s is None:
                            self.kept[label].append((stream, event))

    def _file(self, label: str) -> TextIO:
        if label not in self._files:
            path = self._paths[label]
            path.parent.mkdir(parents=True, exist_ok=True)
            opened = path.open("x", encoding="utf-8", errors="replace", newline="\n")
            self._files[label] = self._stack.enter_context(opened)
            self._files[label].write(line(COLUMNS))
        return self._files[label]


def _row(stream: Stream, event: MarkerEvent, start_s: float = 0.0) -> str:
    undone = "yes" if event.undone else "no"
    onset = f"{event.onset_s - start_s:.6f}"
    told = (event.name, undone, stream.header.name, event.note, event.text)
    length_s = event.duration_s
    duration = NOTHING if length_s is None else f"{length_s:.6f}"
    return line((onset, duration, *told))


def write_run_events(
    root: Path, files: Iterable[RunFile], happened: Sequence[tuple[Stream, MarkerEvent]]
) -> None:
    """Write the events of EEG and EMG runs as tables, and those of EEG as BrainVision markers.

    Each event goes to the last run of a stream that begins before it, or to the first run.

    Parameters
    ----------
    files
        Files of one participant.
    happened
        Events of that participant, in time order.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    for runs in runs_by_start(tuple(files)).values():
        starts = [each.start_s for each in runs]
        dealt: list[list[tuple[Stream, MarkerEvent]]] = [[] for _ in runs]
        for stream, event in happened:
            dealt[max(0, bisect_right(starts, event.onset_s) - 1)].append((stream, event))
        for file, own in zip(runs, dealt, strict=True):
            _write_run_events(root, file, own)


def _write_run_events(root: Path, file: RunFile, own: Sequence[tuple[Stream, MarkerEvent]]) -> None:
    rows = [(each.onset_s - file.start_s, _row(of, each, file.start_s)) for of, each in own]
    marks = [
        (round((each.onset_s - file.start_s) * file.rate_hz), 1, each.name or each.text)
        for _, each in own
    ]
    for onset_s, duration_s, text in file.gap_events():
        told = (f"{onset_s:.6f}", f"{duration_s:.6f}", BAD_GAP, "no", file.stream.header.name)
        rows.append((onset_s, line((*told, text, NOTHING))))
        count = round(duration_s * file.rate_hz)
        marks.append((round(onset_s * file.rate_hz), count, BAD_GAP))
    for onset_s, duration_s, text in file.without:
        told = (f"{onset_s:.6f}", f"{duration_s:.6f}", BAD_VALUE, "no", file.stream.header.name)
        rows.append((onset_s, line((*told, text, NOTHING))))
    # BrainVision markers need a row, so earlier and later events are only in the table.
    inside = sorted(each for each in marks if 0 <= each[0] < file.rows)
    if file.datatype == "eeg":
        write_markers(root / file.path("eeg.vmrk"), inside)
    if rows:
        table = "".join([line(COLUMNS), *(row for _, row in sorted(rows, key=lambda r: r[0]))])
        write_text(root / file.path("events.tsv"), table)
        onset = {"Description": "time since the first sample of the run", "Units": "s"}
        content = {"TaskName": file.entities.task, **COLUMN_DESCRIPTIONS, "onset": onset}
        write_json(root / file.path("events.json"), content)
