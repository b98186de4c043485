"""Writes what happened, of all streams of markers, as a table of events for each person."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.bids.tables import NOTHING, line
from biosensor_gateway.recording.export.happenings import Happening, in_order

COLUMNS = ("onset", "duration", "trial_type", "undone", "stream", "value")
COLUMN_DESCRIPTIONS: Mapping[str, object] = {
    "onset": {"Description": "time since TimeZero", "Units": "s"},
    "duration": {"Description": "not known, as markers are moments", "Units": "s"},
    "trial_type": {"Description": "name of the marker or of a device's event, or a short text"},
    "undone": {"Description": "yes where the experimenter took the marker back later, else no"},
    "stream": {"Description": "name of the LSL stream"},
    "value": {"Description": "the whole text as it was recorded"},
}
Holds = Mapping[int, Iterable[str]]
"""For whom a stream of markers holds: labels, by the stream's number."""


class Events:
    """Tables of events; each is made when its first event comes.

    Parameters
    ----------
    paths
        Of the file of each person, by label.
    participants
        What the recording calls each person, by label.
    """

    def __init__(self, paths: Mapping[str, Path], participants: Mapping[str, str]) -> None:
        self._paths = paths
        self._participants = participants
        self._stack = ExitStack()
        self._files: dict[str, TextIO] = {}
        self.counts: Counter[str] = Counter()
        """Rows by label."""

    def write(self, happenings: Iterable[tuple[Stream, Happening]], holds: Holds) -> None:
        """Write all, in the order of time.

        Parameters
        ----------
        happenings
            Roughly in the order of time.
        holds
            Labels of those for whom a stream of markers holds, by its number.

        Raises
        ------
        OSError
            If a table cannot be written.
        """
        with self._stack:
            for stream, happening in in_order(happenings):
                for label in holds[stream.number]:
                    if happening.participant in ("", self._participants[label]):
                        self._file(label).write(_row(stream, happening))
                        self.counts[label] += 1

    def _file(self, label: str) -> TextIO:
        if label not in self._files:
            path = self._paths[label]
            path.parent.mkdir(parents=True, exist_ok=True)
            opened = path.open("x", encoding="utf-8", errors="replace", newline="\n")
            self._files[label] = self._stack.enter_context(opened)
            self._files[label].write(line(COLUMNS))
        return self._files[label]


def _row(stream: Stream, happening: Happening) -> str:
    undone = "yes" if happening.undone else "no"
    onset = f"{happening.onset_s:.6f}"
    return line((onset, NOTHING, happening.name, undone, stream.header.name, happening.text))
