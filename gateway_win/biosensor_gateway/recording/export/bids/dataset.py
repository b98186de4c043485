"""Writes a dataset: a folder for each person, and what tells of the whole."""

from __future__ import annotations

import heapq
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, TextIO, cast

import numpy as np

from biosensor_common.naming import AGENT, NODE
from biosensor_gateway.recording.contents.choice import Chosen, on_one_clock
from biosensor_gateway.recording.contents.merging import merged
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.contents.wall_clock import EVENTS
from biosensor_gateway.recording.export.bids.file_names import Entities, labels
from biosensor_gateway.recording.export.bids.signals import BEHAVIOUR, Place, Remarks, SignalWriter
from biosensor_gateway.recording.export.bids.subjects import (
    SHARED,
    UNKNOWN,
    Subjects,
    find_subjects,
)
from biosensor_gateway.recording.export.bids.tables import (
    NOTHING,
    line,
    write_json,
    write_rows,
    write_text,
)
from biosensor_gateway.recording.export.bids.timeline import Timeline, timeline
from biosensor_gateway.recording.export.exporter import Missing, Order, Progress, SampleCount
from biosensor_gateway.recording.export.markers import MARKERS, is_markers, texts
from biosensor_gateway.recording.labrecorder.file_name import BidsLabels
from biosensor_gateway.recording.participants import entities_of
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

_USUAL_TASK = "study"
BIDS_VERSION = "1.11.1"
"""The newest that the validator knows."""

_MOST_NAMES = 5
_README = f"""\
# {{name}}

Made from one recording of LSL streams (XDF) by biosensor-gateway {{version}}. Please complete
this text, and name authors and licence in dataset_description.json, before you share it.

- beh/*_physio: signals with a rate. The table has equal steps of 1/SamplingFrequency from
  StartTime on. Every sample stands in the row that is nearest to its time, and the column
  timestamp has the time itself. Nothing was interpolated or left out: where a sample is missing,
  the row is n/a. SamplingFrequency is the real rate between gaps; SamplingFrequencyNominal is
  what the device promised. LargestDisplacement says, in s, how far a sample is from its row at
  most, and SamplesInAnotherRow how many did not find their own row free.
- motion/*_motion: the same of accelerometers and the like. There SamplingFrequency is the nominal
  rate and SamplingFrequencyEffective the real one, as BIDS wants it.
- beh/*_physioevents: signals without a rate, such as beats; onset is their time. OnsetSource is
  empty because they have no table of equal steps beside them.
- beh/*_events.tsv: markers, and what happened to the devices. Rows that are undone were taken back.

All times are in s since TimeZero, which every sidecar names; it is the same for all people.
sub-{UNKNOWN} stands for somebody whom the recording does not name, sub-{SHARED} for streams that
belong to none of several people.
"""
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


class BidsDataset:
    """Writes a dataset in which the BIDS validator finds no error.

    A stream becomes one table, in the folder of the person who wears the device: a regular
    one ``_physio`` or, of what moves, ``_motion``; one without a rate ``_physioevents``.
    Markers become ``_events``.
    """

    suffix = "_bids"

    def write(
        self, chosen: Chosen, order: Order, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        dataset = _Dataset(chosen, order, target, progress)
        target.mkdir()
        return dataset.write()


class _Dataset:
    def __init__(self, chosen: Chosen, order: Order, root: Path, progress: Progress) -> None:
        chosen, self._away = on_one_clock(chosen)
        self._chosen = chosen
        self._order = order
        self._root = root
        self._timeline = timeline(chosen, order.clock)
        self._count = SampleCount(chosen, progress)
        told = entities_of(order.name)
        task = order.task or told.get("task", _USUAL_TASK)
        session = order.session or told.get("ses", "")
        # What somebody typed is refused where it cannot be a label, not changed.
        BidsLabels(UNKNOWN, task=task, session=session or UNKNOWN)
        self._entities = Entities("", task, session, told.get("acq", ""), told.get("run", ""))
        streams = [each for each in chosen.streams if not is_left_out(each)]
        self._signals = [each for each in streams if not is_markers(each)]
        self._markers = [each for each in streams if is_markers(each)]
        self._subjects = find_subjects(chosen, streams, told.get("sub", ""))

    def write(self) -> list[str]:
        writer = SignalWriter(self._chosen, self._timeline, self._root, self._count)
        places = self._places()
        written = {
            self._subjects.of(each)
            for each in self._signals
            if writer.write(each, places[each.number])
        }
        written |= self._write_events()
        if not written:
            path = self._chosen.contents.path
            message = f"{path} holds nothing that BIDS has a place for"
            raise RecordingError(RecordingReason.EMPTY, message)
        describe(self._root, self._order.name, self._subjects, written)
        missing = [
            Missing(f"{each.header.name}: left out, for {each.clock_error}") for each in self._away
        ]
        return [*missing, *sentences(writer.remarks, self._subjects)]

    def _places(self) -> dict[int, Place]:
        """Give each stream its place, by its number."""
        found: dict[int, Place] = {}
        for subject in {self._subjects.of(each) for each in self._signals}:
            own = [each for each in self._signals if self._subjects.of(each) == subject]
            named = labels({each.number: _names(each) for each in own})
            entities = replace(self._entities, subject=subject)
            found |= {number: Place(entities, name) for number, name in named.items()}
        return found

    def _write_events(self) -> set[str]:
        """Write the events of everybody; return the labels of those who have some."""
        participants = self._subjects.participants
        entities = {each: replace(self._entities, subject=each) for each in participants}
        paths = {key: self._root / of.path(BEHAVIOUR, "events.tsv") for key, of in entities.items()}
        events = Events(paths, participants)
        holds = {each.number: self._subjects.of_markers(each) for each in self._markers}
        events.write(self._happenings(), holds)
        for key in events.counts:
            content = {
                "TaskName": self._entities.task,
                **DESCRIBED,
                **self._timeline.described(),
            }
            write_json(self._root / entities[key].path(BEHAVIOUR, "events.json"), content)
        return set(events.counts)

    def _happenings(self) -> Iterator[tuple[Stream, Happening]]:
        span = (self._chosen.begin_s, self._chosen.end_s)
        for stream, samples in merged(self._markers, *span):
            for happening in happenings(stream, samples, self._timeline):
                if self._order.participant:
                    happening.participant = ""
                yield stream, happening
            self._count.add(len(samples))


def _names(stream: Stream) -> Sequence[str]:
    """Return what a stream is called, and what tells it from others that are called so."""
    header, identity = stream.header, stream.header.identity
    if identity is None:
        return (header.name or header.content_type, header.content_type, header.source_id)
    return (f"{identity.sensor}{identity.label}{header.data_name}", identity.unit)


def describe(root: Path, name: str, subjects: Subjects, written: set[str]) -> None:
    """Write what a dataset needs beside its tables.

    Parameters
    ----------
    name
        Of the recording.
    written
        Labels of those who have a folder.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    gateway = version("biosensor-gateway")
    description = {
        "Name": name,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "GeneratedBy": [{"Name": "biosensor-gateway", "Version": gateway}],
    }
    write_json(root / "dataset_description.json", description)
    write_text(root / "README.md", _README.format(name=name, version=gateway))
    rows = [
        (f"sub-{label}", called)
        for label, called in subjects.participants.items()
        if label in written
    ]
    write_rows(root / "participants.tsv", [("participant_id", "recorded_as"), *rows])
    told = {"recorded_as": {"Description": "what the headers of the streams call this person"}}
    write_json(root / "participants.json", told)


def sentences(remarks: Remarks, subjects: Subjects) -> Iterator[str]:
    """Give what a person should know at once."""
    if subjects.participants.get(UNKNOWN) == "":
        yield f"no stream names a participant: all is in sub-{UNKNOWN}"
    elif subjects.participants.get(subjects.nobodys) == "":
        yield f"streams that name nobody are in sub-{subjects.nobodys}; markers hold for everybody"
    if remarks.without_samples:
        yield f"no samples, so no table: {_listed(remarks.without_samples)}"
    if remarks.without_table:
        yield Missing(
            "stamps far from any rate, so no table of equal steps; "
            f"csv has them: {_listed(remarks.without_table)}"
        )
    if remarks.cut:
        yield (
            "cut into several tables, where a gap is longer than an hour or time steps back: "
            f"{_listed(remarks.cut)}"
        )
    if remarks.moved:
        yield (
            "some samples are not in the row of their time, as it was taken; the column "
            f"timestamp has the time, the sidecar how many and how far: {_listed(remarks.moved)}"
        )
    if remarks.unplaced:
        yield f"{remarks.unplaced} samples have stamps of no clock and were left out"


def _listed(names: Sequence[str]) -> str:
    rest = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + rest


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
