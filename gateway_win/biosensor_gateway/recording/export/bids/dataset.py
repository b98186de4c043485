"""Writes a dataset: a folder for each participant with all events, and files about the whole."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TextIO

from biosensor_gateway.recording.contents.choice import Chosen, merged, on_one_clock
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.bids.brain_vision import write_markers
from biosensor_gateway.recording.export.bids.file_names import (
    NOTHING,
    Entities,
    kind_of,
    labels,
    line,
    write_json,
    write_rows,
    write_text,
)
from biosensor_gateway.recording.export.bids.run_file import RunFile, runs_by_start
from biosensor_gateway.recording.export.bids.signals import BEHAVIOUR, Place, Remarks, SignalWriter
from biosensor_gateway.recording.export.exporter import (
    ExportOptions,
    Missing,
    Progress,
    SampleCount,
    timeline,
)
from biosensor_gateway.recording.export.marker_events import (
    MarkerEvent,
    gap_event,
    in_order,
    is_left_out,
    marker_events,
)
from biosensor_gateway.recording.export.runs import BAD_GAP
from biosensor_gateway.recording.participants import entities_of
from biosensor_gateway.recording.recorder.request import BidsLabels
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

UNKNOWN = "unknown"
"""Label of a participant whose name is unknown."""
SHARED = "shared"
"""Label of the folder for data that belongs to none of several participants."""
BAD_VALUE = "BAD_value"
"""Event for a missing value in a format that has no missing values."""
COLUMNS = ("onset", "duration", "trial_type", "undone", "stream", "note", "value")
COLUMN_DESCRIPTIONS: Mapping[str, object] = {
    "onset": {"Description": "time since TimeZero", "Units": "s"},
    "duration": {
        "Description": "of a gap; otherwise not known, because markers are instants",
        "Units": "s",
    },
    "trial_type": {"Description": "name of the marker or of a device's event, or a short text"},
    "undone": {"Description": "yes where the experimenter took the marker back later, else no"},
    "stream": {"Description": "name of the LSL stream"},
    "note": {"Description": "free text of the experimenter's marker"},
    "value": {"Description": "the full text as it was recorded"},
}
Holds = Mapping[int, Iterable[str]]
"""The participants' labels of each marker stream, by stream number."""


@dataclass(frozen=True, slots=True)
class Subjects:
    """The participants of a recording."""

    # Their names in the recording by label; empty for `UNKNOWN` and `SHARED`.
    participants: Mapping[str, str]
    nobodys: str  # Label of the folder for streams without a participant.

    def of(self, stream: Stream) -> str:
        """Return the label of a stream's participant."""
        name = stream.participant
        if not name:
            return self.nobodys
        return next(key for key, called in self.participants.items() if called == name)

    def of_markers(self, stream: Stream) -> tuple[str, ...]:
        """Return the labels of a marker stream's participants; all, if it names none."""
        return (self.of(stream),) if stream.participant else tuple(self.participants)


def find_subjects(chosen: Chosen, streams: Sequence[Stream], named: str) -> Subjects:
    """Determine the participants of a recording.

    Streams without a participant are assigned to a single participant. With several participants,
    they get a separate folder, unless they are only markers.

    Parameters
    ----------
    chosen
        The selection; participants left out of it still count.
    named
        Subject label in the recording's name; empty if there is none.
    """
    people = _people(streams)
    if not people and len(_people(chosen.contents.streams)) < 2:
        only = named or UNKNOWN
        return Subjects({only: ""}, only)
    # Reserved, so that no participant gets the same label.
    found = labels({"": [SHARED], **{each: [each] for each in people}})
    shared = found.pop("")
    called = {found[each]: each for each in people}
    if len(_people(chosen.contents.streams)) == 1:
        return Subjects(called, next(iter(called)))
    has_shared = any(not each.participant and not each.header.is_markers for each in streams)
    return Subjects(called | ({shared: ""} if has_shared or not people else {}), shared)


def _people(streams: Sequence[Stream]) -> list[str]:
    named = [each.participant for each in streams]
    return list(dict.fromkeys(each for each in named if each))


_USUAL_TASK = "study"
BIDS_VERSION = "1.11.1"
"""The newest version that the validator supports."""

_MOST_NAMES = 5
README = f"""\
# {{name}}

Made from recordings of LSL streams (XDF) by biosensor-gateway {{version}}. Please complete
this text, and name authors and licence in dataset_description.json, before you share it.

- beh/*_physio: signals with a rate. The table has equal steps of 1/SamplingFrequency from
  StartTime on. Every sample is in the row nearest to its time, and the column
  timestamp has the time itself. Nothing was interpolated or left out: where a sample is missing,
  the row is n/a. SamplingFrequency is the real rate between gaps; SamplingFrequencyNominal is
  what the device promised. LargestDisplacement is the greatest distance of a sample from its
  row, in s, and SamplesInAnotherRow the number of samples whose own row was taken.
- motion/*_motion: the same for accelerometers and the like. There SamplingFrequency is the nominal
  rate and SamplingFrequencyEffective the real one, as BIDS requires.
- beh/*_recording-eye1_physio: gaze of an eye tracker, a table for each eye.
- emg/*_emg: EMG as BDF+ files, in 24 bits. Where a value was lost, the lowest one is written, and
  an event BAD_gap or BAD_value marks it.
- eeg/*_eeg: EEG as BrainVision files, unscaled. Rows that were lost are NaN and have an event
  BAD_gap; after a gap of more than 10 s a new run starts. Onsets of their events count from the
  first sample of the run.
- beh/*_physioevents: signals without a rate, such as beats; onset is their time. OnsetSource is
  empty because there is no table of equal steps for them.
- beh/*_events.tsv: markers, and what happened to the devices. Rows that are undone were taken back.

All times are in s since TimeZero, which every sidecar names; it is the same for all people of one
recording.
sub-{UNKNOWN} is a person whom the recording does not name, sub-{SHARED} holds streams that
belong to none of several people.
"""


class BidsDataset:
    """Writes a dataset that passes the BIDS validator.

    Each stream becomes one table in the folder of its participant: ``_physio`` or, for movement,
    ``_motion`` if it is regular, and ``_physioevents`` if not. Markers become ``_events``.
    """

    suffix = "_bids"

    def write(
        self, chosen: Chosen, options: ExportOptions, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        dataset = _Dataset(chosen, options, target, progress)
        target.mkdir()
        return dataset.write()


class _Dataset:
    def __init__(
        self, chosen: Chosen, options: ExportOptions, root: Path, progress: Progress
    ) -> None:
        chosen, away = on_one_clock(chosen)
        # A table of events has a place for them; one of samples has none.
        self._away = [each for each in away if not each.header.is_markers]
        markers_away = [each for each in away if each.header.is_markers]
        self._chosen = chosen
        self._options = options
        self._root = root
        self._timeline = timeline(chosen, options.clock)
        self._count = SampleCount(chosen, progress)
        told = entities_of(options.name)
        task = options.task or told.get("task", _USUAL_TASK)
        session = options.session or told.get("ses", "")
        # Invalid labels typed by the user raise an error instead of being changed.
        BidsLabels(UNKNOWN, task=task, session=session or UNKNOWN)
        self._entities = Entities("", task, session, told.get("acq", ""), told.get("run", ""))
        streams = [each for each in (*chosen.streams, *markers_away) if not is_left_out(each)]
        self._signals = [each for each in streams if not each.header.is_markers]
        self._markers = [each for each in streams if each.header.is_markers]
        self._subjects = find_subjects(chosen, streams, told.get("sub", ""))

    def write(self) -> list[str]:
        writer = SignalWriter(self._chosen, self._options, self._timeline, self._root, self._count)
        places = self._places()
        written = {
            self._subjects.of(each)
            for each in self._signals
            if writer.write(each, places[each.number])
        }
        written |= self._write_events(writer)
        if not written:
            path = self._chosen.contents.path
            message = f"{path} has no data for which BIDS has a place"
            raise RecordingError(RecordingReason.EMPTY, message)
        describe(self._root, self._options.name, self._subjects, written)
        missing = [
            Missing(f"{each.header.title}: left out, because {each.clock_error}")
            for each in self._away
        ]
        return [*missing, *sentences(writer.remarks, self._subjects)]

    def _places(self) -> dict[int, Place]:
        """Return the place of each stream by stream number."""
        found: dict[int, Place] = {}
        for subject in {self._subjects.of(each) for each in self._signals}:
            own = [each for each in self._signals if self._subjects.of(each) == subject]
            named = labels({each.number: _names(each) for each in own})
            entities = replace(self._entities, subject=subject)
            kinds = Counter(kind_of(each) for each in own)
            for each in own:
                is_one_of_several = kinds[kind_of(each)] > 1
                place = Place(entities, named[each.number], is_one_of_several)
                found[each.number] = place
        return found

    def _write_events(self, writer: SignalWriter) -> set[str]:
        """Write the events of all participants; return the labels of those with events."""
        participants = self._subjects.participants
        entities = {each: replace(self._entities, subject=each) for each in participants}
        paths = {key: self._root / of.path(BEHAVIOUR, "events.tsv") for key, of in entities.items()}
        events = Events(paths, participants)
        events.kept = {self._subjects.of(each.stream): [] for each in writer.runs}
        holds = {each.number: self._subjects.of_markers(each) for each in self._markers}
        holds |= {each.number: (self._subjects.of(each),) for each in self._signals}
        gaps = [(stream, gap_event(stream, gap, self._timeline)) for stream, gap in writer.gaps]
        for _, each in gaps:
            # The folder shows the participant; the recorded name could contradict the file name.
            each.participant = ""
        events.write(self._marker_events(), gaps, holds)
        for label, happened in events.kept.items():
            own = [each for each in writer.runs if self._subjects.of(each.stream) == label]
            write_run_events(self._root, own, happened)
        for key in events.counts:
            content = {
                "TaskName": self._entities.task,
                **COLUMN_DESCRIPTIONS,
                **self._timeline.described(),
            }
            write_json(self._root / entities[key].path(BEHAVIOUR, "events.json"), content)
        return set(events.counts)

    def _marker_events(self) -> Iterator[tuple[Stream, MarkerEvent]]:
        span = (self._chosen.begin_s, self._chosen.end_s)
        for stream, samples in merged(self._markers, *span):
            for event in marker_events(stream, samples, self._timeline):
                if self._options.participant:
                    event.participant = ""
                yield stream, event
            self._count.add(len(samples))


def _names(stream: Stream) -> Sequence[str]:
    """Return names for a stream, from its usual name to more specific ones."""
    header, identity = stream.header, stream.header.identity
    if identity is None:
        return (header.name or header.content_type, header.content_type, header.source_id)
    return (f"{identity.sensor}{identity.label}{header.data_name}", identity.unit)


def describe(root: Path, name: str, subjects: Subjects, written: set[str]) -> None:
    """Write the files that describe the dataset.

    Parameters
    ----------
    written
        Labels of the participants with a folder.

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
    write_text(root / "README.md", README.format(name=name, version=gateway))
    rows = [
        (f"sub-{label}", called)
        for label, called in subjects.participants.items()
        if label in written
    ]
    write_rows(root / "participants.tsv", [("participant_id", "recorded_as"), *rows])
    told = {"recorded_as": {"Description": "what the headers of the streams call this person"}}
    write_json(root / "participants.json", told)


def sentences(remarks: Remarks, subjects: Subjects) -> Iterator[str]:
    """Yield the most important notes for the user."""
    if subjects.participants.get(UNKNOWN) == "":
        yield f"no stream names a participant: everything is in sub-{UNKNOWN}"
    elif subjects.participants.get(subjects.nobodys) == "":
        yield (
            f"streams without a participant are in sub-{subjects.nobodys}; markers apply to "
            "everybody"
        )
    if remarks.without_samples:
        yield f"no samples, so no table: {_listed(remarks.without_samples)}"
    if remarks.without_table:
        yield Missing(
            "timestamps fit no rate, so no table of equal steps; csv has them: "
            f"{_listed(remarks.without_table)}"
        )
    if remarks.cut:
        yield (
            "cut into several tables, where a gap is longer than an hour or time steps back: "
            f"{_listed(remarks.cut)}"
        )
    yield from remarks.sentences
    if remarks.in_24_bits:
        yield f"EMG, which BIDS stores as BDF, in 24 bits: {_listed(remarks.in_24_bits)}"
    if remarks.runs:
        yield f"gaps of more than 10 s start a new run: {_listed(remarks.runs)}"
    if remarks.rounded:
        yield (
            "EEG in double64 or int32, which BrainVision stores as the nearest float32: "
            f"{_listed(remarks.rounded)}"
        )
    if remarks.moved:
        yield (
            "some samples are not in the row of their time, because it was taken; the column "
            "timestamp has the time, the sidecar how many they are and how far off: "
            f"{_listed(remarks.moved)}"
        )
    if remarks.unplaced:
        yield Missing(f"{remarks.unplaced} samples have timestamps of no clock and were left out")


def _listed(names: Sequence[str]) -> str:
    rest = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + rest


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
    told = (event.name, undone, stream.header.title, event.note, event.text)
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
        told = (f"{onset_s:.6f}", f"{duration_s:.6f}", BAD_GAP, "no", file.stream.header.title)
        rows.append((onset_s, line((*told, text, NOTHING))))
        count = round(duration_s * file.rate_hz)
        marks.append((round(onset_s * file.rate_hz), count, BAD_GAP))
    for onset_s, duration_s, text in file.without:
        told = (f"{onset_s:.6f}", f"{duration_s:.6f}", BAD_VALUE, "no", file.stream.header.title)
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
