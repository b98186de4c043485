"""Writes what happened, of all streams of markers, as a table of events for each person."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple, TextIO

from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.bids.happening import Happening
from biosensor_gateway.recording.export.bids.tables import NOTHING, line

HEAD = ("onset", "duration", "trial_type", "undone", "stream", "value")
DESCRIBED: Mapping[str, object] = {
    "onset": {"Description": "time since TimeZero", "Units": "s"},
    "duration": {"Description": "not known, as markers are moments", "Units": "s"},
    "trial_type": {"Description": "name of the marker or of a device's event, or a short text"},
    "undone": {"Description": "yes where the experimenter took the marker back later, else no"},
    "stream": {"Description": "name of the LSL stream"},
    "value": {"Description": "the whole text as it was recorded"},
}
Holds = Mapping[int, Iterable[str]]
"""For whom a stream of markers holds: labels, by the stream's number."""

_KEPT = 10_000
"""Rows that are held back, to be sorted, and because they may be undone."""


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
            for stream, happening in _sorted(happenings):
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
            self._files[label].write(line(HEAD))
        return self._files[label]


def _row(stream: Stream, happening: Happening) -> str:
    undone = "yes" if happening.undone else "no"
    onset = f"{happening.onset_s:.6f}"
    return line((onset, NOTHING, happening.name, undone, stream.header.name, happening.text))


def _sorted(
    happenings: Iterable[tuple[Stream, Happening]],
) -> Iterator[tuple[Stream, Happening]]:
    """Sort by time, and undo what is undone, as far as it is held back."""
    kept: list[_Kept] = []
    newest: dict[tuple[int, int], Happening] = {}
    for order, (stream, happening) in enumerate(happenings):
        if happening.undoes is not None:
            if undone := newest.get((stream.number, happening.undoes)):
                undone.undone = True
        elif happening.id is not None:
            newest[stream.number, happening.id] = happening
        heapq.heappush(kept, _Kept(happening.onset_s, order, stream, happening))
        if len(kept) > _KEPT:
            first = heapq.heappop(kept)
            _forget(newest, first)
            yield first.stream, first.happening
    while kept:
        first = heapq.heappop(kept)
        yield first.stream, first.happening


class _Kept(NamedTuple):
    onset_s: float
    order: int
    stream: Stream
    happening: Happening


def _forget(newest: dict[tuple[int, int], Happening], kept: _Kept) -> None:
    number = kept.happening.id
    if number is not None and newest.get((kept.stream.number, number)) is kept.happening:
        del newest[kept.stream.number, number]
