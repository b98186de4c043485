"""Searches folders for a person, and plans what to do with each file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum, unique
from pathlib import Path

from biosensor_gateway.recording.export.bids.study import is_dataset
from biosensor_gateway.recording.export.several import is_recording
from biosensor_gateway.recording.participants import entities_of, listed
from biosensor_gateway.recording.withdrawal import bags, recordings, texts
from biosensor_gateway.recording.withdrawal.traces import Person, Pieces
from biosensor_gateway.recording.xdf.container import RecordingError

_EXPORTED = frozenset(
    {".bdf", ".csv", ".db3", ".edf", ".eeg", ".gz", ".json", ".mcap", ".tsv", ".txt", ".vhdr"}
    | {".vmrk"}
)


@unique
class Action(StrEnum):
    """What to do with a file or folder."""

    DELETE = "delete"
    REWRITE = "rewrite"
    """Rewrite it without the person."""
    LOOK = "look"
    """Leave it for the user, because its owner or how to change it is unclear."""


@dataclass(frozen=True, slots=True)
class Step:
    """One file or folder of a plan; `why` is a sentence."""

    path: Path
    action: Action
    why: str


@dataclass(frozen=True, slots=True)
class Plan:
    """The steps to remove a person.

    Attributes
    ----------
    places
        The folders searched.
    files
        Number of files inspected.
    """

    person: str
    places: tuple[Path, ...]
    steps: tuple[Step, ...]
    files: int
    pieces: Pieces = field(default_factory=Pieces)


def plan(name: str, places: Sequence[Path]) -> Plan:
    """Plan the removal of a person from files and folders."""
    person, pieces = Person(name), Pieces()
    looked = _Looking(person, pieces)
    steps = [step for place in places for step in looked.at(place)]
    return Plan(name, tuple(places), tuple(steps), looked.files, pieces)


class _Looking:
    def __init__(self, person: Person, pieces: Pieces) -> None:
        self._person, self._pieces = person, pieces
        self.files = 0

    def at(self, place: Path) -> Iterator[Step]:
        """Yield the steps for a file or folder."""
        if place.is_symlink():
            return
        if not place.is_dir():
            self.files += 1
            step = self._of_file(place)
            if step is not None:
                yield step
        elif is_dataset(place.parent) and self._is_theirs(place):
            self.files += sum(each.is_file() for each in place.rglob("*"))
            yield Step(place, Action.DELETE, "the folder of the person in a data set")
        elif bags.is_bag(place):
            self.files += sum(each.is_file() for each in place.rglob("*"))
            step = self._of_bag(place)
            if step is not None:
                yield step
        else:
            for each in sorted(place.iterdir()):
                yield from self.at(each)

    def _is_theirs(self, path: Path) -> bool:
        return self._person.is_called(entities_of(path.name.partition(".")[0]).get("sub", ""))

    def _of_file(self, path: Path) -> Step | None:
        try:
            if is_recording(path):
                return self._of_recording(path)
            if self._person.is_in(path.name):
                return self._named(path)
            if texts.is_text(path):
                return self._of_text(path)
            if path.suffix.lower() in texts.EDF:
                return self._of_edf(path)
        except (OSError, RecordingError, ValueError) as error:
            return Step(path, Action.LOOK, f"it cannot be read: {error}")
        return None

    def _of_recording(self, path: Path) -> Step | None:
        seen = recordings.look(path, self._person, self._pieces)
        if self._person.is_in(path.name):
            if seen.others:
                why = f"it is called after the person, and {listed(seen.others)} wear its sensors"
                return Step(path, Action.LOOK, f"{why}; rename it first, or delete it yourself")
            recordings.take_pieces_of_all(path, self._pieces)
            return Step(path, Action.DELETE, "a recording of this person alone")
        if seen.own and not seen.others and not seen.unnamed:
            return Step(path, Action.DELETE, "all sensors of it were worn by this person")
        if not seen.own and not seen.texts:
            return None
        what: list[str] = []
        if seen.own:
            streams = "1 stream" if len(seen.own) == 1 else f"{len(seen.own)} streams"
            what.append(f"without {streams} of the person")
        if seen.texts:
            what.append(f"without the name in {listed(seen.texts)}")
        if seen.damages:
            what.append("and without what cannot be read of it")
        return Step(path, Action.REWRITE, ", ".join(what))

    def _named(self, path: Path) -> Step:
        if path.suffix.lower() in _EXPORTED:
            return Step(path, Action.DELETE, "it is called after the person")
        return Step(path, Action.LOOK, "it is called after the person, and is of no known kind")

    def _of_text(self, path: Path) -> Step | None:
        lines = texts.lines_of(path, self._person)
        if not lines:
            return None
        if path.suffix == ".json":
            return Step(path, Action.REWRITE, "without what it says of the person")
        told = "1 line that names" if lines == 1 else f"{lines} lines that name"
        return Step(path, Action.REWRITE, f"without {told} the person")

    def _of_edf(self, path: Path) -> Step | None:
        told = sum(self._person.is_in_bytes(each) for each in texts.texts_of_edf(path))
        if not told:
            return None
        return Step(path, Action.REWRITE, "with other letters in place of the person's name")

    def _of_bag(self, path: Path) -> Step | None:
        if self._is_theirs(path):
            return Step(path, Action.DELETE, "a bag of this person's recording")
        try:
            own, others = bags.topics_of(path, self._person)
        # The library raises many kinds of errors; an unreadable bag is reported.
        except Exception as error:  # noqa: BLE001 - any of a library's
            return Step(path, Action.LOOK, f"the bag cannot be read: {error}")
        if not own:
            return None
        if not others:
            return Step(path, Action.DELETE, "all topics of it are of this person")
        return Step(path, Action.REWRITE, f"without {len(own)} topics of the person")
