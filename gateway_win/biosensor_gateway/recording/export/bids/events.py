"""Writes what happened, of all streams of markers, as a table of events for each person."""

from __future__ import annotations

import heapq
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TextIO, cast

import numpy as np

from biosensor_common.naming import AGENT, NODE
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.contents.wall_clock import EVENTS
from biosensor_gateway.recording.export.bids.tables import NOTHING, line
from biosensor_gateway.recording.export.bids.timeline import Timeline
from biosensor_gateway.recording.export.markers import MARKERS, texts

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

_KEPT = 10_000
"""Rows that are held back, to be sorted, and because they may be undone."""
_LONGEST_NAME = 100
# A marker that was told later is at most an hour late.
_MOST_APART_S = 2 * 3600.0
_OF_DEVICES = frozenset(
    {
        "connected",
        "disconnected",
        "gap_start",
        "gap_end",
        "clock_reanchored",
        "settings_changed",
        "off_body",
        "on_body",
        "paused",
        "resumed",
    }
)


@dataclass(slots=True)
class Happening:
    """Something that happened at one moment.

    Attributes
    ----------
    onset_s
        Seconds since zero.
    name
        Empty where only `text` tells it.
    text
        As recorded.
    participant
        Whose it is only; empty for all for whom the stream is.
    id, undoes
        Of a marker of the agent, its number, and that of the one that it takes back.
    undone
        Whether it was taken back.
    """

    onset_s: float
    name: str
    text: str
    participant: str = ""
    id: int | None = None
    undoes: int | None = None
    undone: bool = False


def is_left_out(stream: Stream) -> bool:
    """Whether a stream of ours tells nothing of a person: counters, and what a node says."""
    identity = stream.header.identity
    if identity is None or identity.sensor not in (AGENT, NODE):
        return False
    return identity.sensor == NODE or stream.header.data_name not in (EVENTS, MARKERS)


def happenings(stream: Stream, samples: Samples, timeline: Timeline) -> Iterator[Happening]:
    """Give what the samples of a stream of markers say."""
    identity = stream.header.identity
    kind = stream.header.data_name if identity is not None and identity.sensor == AGENT else ""
    onsets = timeline.since_zero(samples.times).tolist()
    for place, onset_s in enumerate(onsets):
        told = texts(samples.values[place])
        whole = told[0] if len(told) == 1 else json.dumps(told, ensure_ascii=False)
        happening = Happening(onset_s, "", whole)
        if kind:
            content = _content(happening.text)
            if kind == EVENTS and content.get("event") not in _OF_DEVICES:
                continue
            _tell(happening, content)
            happening.onset_s = _told_onset(samples, place, content, timeline, onset_s)
        elif len(whole) <= _LONGEST_NAME:
            happening.name = ", ".join(told)
        yield happening


def _tell(happening: Happening, content: Mapping[str, Any]) -> None:
    happening.name = str(content.get("marker") or content.get("event") or "")
    happening.participant = str(content.get("participant") or "")
    happening.id = _whole(content.get("id"))
    happening.undoes = _whole(content.get("of"))


def _told_onset(
    samples: Samples, place: int, content: Mapping[str, Any], timeline: Timeline, onset_s: float
) -> float:
    """Return when it happened by its own words: a stamp is never before that of another marker."""
    told = content.get("lsl_time")
    if not isinstance(told, int | float) or not math.isfinite(told):
        return onset_s
    time_s, stamp_s = float(samples.times[place]), float(samples.stamps[place])
    if abs(told - stamp_s) > _MOST_APART_S:
        return onset_s
    return float(timeline.since_zero(np.array([time_s - stamp_s + told]))[0])


def _content(text: str) -> Mapping[str, Any]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return cast("Mapping[str, Any]", content) if isinstance(content, dict) else {}


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) else None


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
            self._files[label].write(line(COLUMNS))
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
