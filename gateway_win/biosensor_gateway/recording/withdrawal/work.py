"""Plans a withdrawal in folders and bags, carries it out, and proves that nothing is left."""

from __future__ import annotations

import csv
import errno
import hashlib
import json
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum, unique
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from biosensor_common.errors import cannot_write
from biosensor_gateway.recording.bag.bag_file import read_bag
from biosensor_gateway.recording.bag.types import BagError
from biosensor_gateway.recording.export.bids.study import CALLED, ID, PARTICIPANTS, is_dataset
from biosensor_gateway.recording.export.job import is_recording
from biosensor_gateway.recording.participants import entities_of, listed
from biosensor_gateway.recording.recorder.state import is_going_on
from biosensor_gateway.recording.withdrawal import recordings
from biosensor_gateway.recording.withdrawal.pieces import Pieces, blocks
from biosensor_gateway.recording.withdrawal.traces import (
    EDF,
    LONGEST_JSON,
    Person,
    columns_of,
    is_in_message,
    is_text,
    is_utf16,
    lines_of,
    open_plain,
    texts_of_edf,
    write_edf_without,
    write_without,
)
from biosensor_gateway.recording.xdf.container import RecordingError, open_recording

_EXPORTED = frozenset(
    {".bdf", ".csv", ".db3", ".edf", ".eeg", ".gz", ".json", ".mcap", ".tsv", ".txt", ".vhdr"}
    | {".vmrk"}
)


_BLOCK_BYTES = 1 << 20
_LONGEST_NAME = 256
_NUMBERS = (".eeg",)
_BAGS = (".mcap", ".db3", ".zstd")
_METADATA = "metadata.yaml"


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
    """The steps to remove a person."""

    person: str
    places: tuple[Path, ...]
    steps: tuple[Step, ...]
    files: int
    pieces: Pieces = field(default_factory=Pieces)
    shares_label: bool = False


def plan(name: str, places: Sequence[Path]) -> Plan:
    """Plan the removal of a person from files and folders."""
    person, pieces = Person(name), Pieces()
    if not person.is_label and _shares_label(person, places):
        person = Person(name, shares_label=True)
    looked = _Looking(person, pieces)
    steps = [step for place in places for step in looked.at(place, is_below=False)]
    return Plan(
        name, tuple(places), tuple(steps), looked.files, pieces, shares_label=not person.owns_label
    )


def _shares_label(person: Person, places: Sequence[Path]) -> bool:
    """Whether somebody else in these folders has the BIDS label of a person."""
    return any(
        person.has_label(each) and not person.is_called(each)
        for place in places
        for path in _files(place)
        for each in _people(path)
    )


def _people(path: Path) -> Iterable[str]:
    try:
        if is_recording(path):
            return recordings.participants(path)
        if path.name == PARTICIPANTS:
            return [each.get(CALLED) or "" for each in _rows_of(path)]
    except (OSError, RecordingError, ValueError):
        pass  # The plan says of a file that it cannot be read.
    return ()


def _rows_of(table: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(table.read_text("utf-8").splitlines(), delimiter="\t"))


class _Looking:
    def __init__(self, person: Person, pieces: Pieces) -> None:
        self._person, self._pieces = person, pieces
        self.files = 0

    def at(self, place: Path, *, is_below: bool = True) -> Iterator[Step]:
        """Yield the steps for a file or folder; a folder that is asked for may have any name."""
        if place.is_symlink():
            return
        if not place.is_dir():
            self.files += 1
            step = self._of_file(place)
            if step is not None:
                yield step
        elif is_dataset(place.parent) and self._is_theirs(place):
            self.files += sum(each.is_file() for each in place.rglob("*"))
            yield self._of_subject(place)
        elif (whole := _interrupted(place)) is not None and whole.exists():
            yield Step(place, Action.DELETE, "left by a withdrawal that was interrupted")
        elif _is_bag(place):
            self.files += sum(each.is_file() for each in place.rglob("*"))
            step = self._of_bag(place)
            if step is not None:
                yield step
        else:
            try:
                inside = sorted(place.iterdir())
            except OSError as error:
                yield Step(place, Action.LOOK, f"it cannot be read: {error.strerror or error}")
                return
            before = self.files
            steps = [step for each in inside for step in self.at(each)]
            if is_below and self._person.is_in(place.name):
                yield from self._of_named_folder(place, steps, self.files - before)
            else:
                yield from steps

    def _of_named_folder(self, place: Path, steps: list[Step], files: int) -> Iterator[Step]:
        deleted = [each.path for each in steps if each.action is Action.DELETE]
        if files and sum(1 for each in deleted for _ in _files(each)) == files:
            yield Step(place, Action.DELETE, "a folder of this person alone")
            return
        yield from steps
        why = "a folder that is named after the person: delete what is left in it if it is theirs"
        yield Step(place, Action.LOOK, why)

    def _is_theirs(self, path: Path) -> bool:
        named = _recorded_as(path)
        if named:
            return self._person.is_called(named)
        return self._person.has_label(entities_of(path.name.partition(".")[0]).get("sub", ""))

    def _of_subject(self, folder: Path) -> Step:
        if not (self._person.owns_label or _recorded_as(folder)):
            why = "a folder of a data set that has the person's label, and does not say whose it is"
            return Step(folder, Action.LOOK, why)
        return Step(folder, Action.DELETE, "the person's folder in a data set")

    def _of_file(self, path: Path) -> Step | None:
        try:
            if is_recording(path):
                return self._of_recording(path)
            if self._person.is_in(path.name):
                return self._named(path)
            if self._person.is_in(_stream_of(path)):
                return Step(path, Action.DELETE, "it is of a stream that is named after the person")
            if is_text(path):
                return self._of_text(path)
            return self._of_edf(path) if path.suffix.lower() in EDF else None
        except (OSError, RecordingError, ValueError) as error:
            return Step(path, Action.LOOK, f"it cannot be read: {error}")

    def _of_recording(self, path: Path) -> Step | None:
        if is_going_on(path):
            why = "it is still being recorded: end that first with record stop, and withdraw again"
            return Step(path, Action.LOOK, why)
        seen = recordings.look(path, self._person, self._pieces)
        if self._person.is_in(path.name):
            if seen.others:
                why = f"it is named after the person, but {listed(seen.others)} wear its sensors"
                return Step(path, Action.LOOK, f"{why}; rename it first, or delete it yourself")
            recordings.take_pieces_of_all(path, self._pieces)
            return Step(path, Action.DELETE, "a recording of this person alone")
        if seen.own and not seen.others and not seen.unnamed:
            return Step(path, Action.DELETE, "all its sensors were worn by this person")
        if not seen.own and not seen.texts:
            alike = [each for each in seen.others if self._person.has_label(each)]
            why = f"{listed(alike)} may be the same person: withdraw that, too, if it is"
            return Step(path, Action.LOOK, why) if alike else None
        what: list[str] = []
        if seen.own:
            streams = "1 stream" if len(seen.own) == 1 else f"{len(seen.own)} streams"
            what.append(f"without the person's {streams}")
        if seen.texts:
            what.append(f"without the name in {listed(seen.texts)}")
        if seen.damages:
            what.append("and without its unreadable parts")
        return Step(path, Action.REWRITE, ", ".join(what))

    def _named(self, path: Path) -> Step:
        if path.suffix.lower() in _EXPORTED:
            return Step(path, Action.DELETE, "it is named after the person")
        return Step(path, Action.LOOK, "it is named after the person, but its format is not known")

    def _of_text(self, path: Path) -> Step | None:
        if is_utf16(path):
            with open_plain(path) as file:
                is_named = self._person.is_in_bytes(file.read())
            why = "it names the person in UTF-16: remove these lines yourself, or save it as UTF-8"
            return Step(path, Action.LOOK, why) if is_named else None
        lines = lines_of(path, self._person)
        if not lines:
            return None
        if columns_of(path, self._person) is not None:
            return Step(path, Action.REWRITE, "without the person's columns and name")
        if path.suffix == ".json":
            return Step(path, Action.REWRITE, "without its information about the person")
        told = "1 line that names" if lines == 1 else f"{lines} lines that name"
        return Step(path, Action.REWRITE, f"without {told} the person")

    def _of_edf(self, path: Path) -> Step | None:
        told = sum(self._person.is_in_bytes(each) for each in texts_of_edf(path))
        if not told:
            return None
        return Step(path, Action.REWRITE, "with the person's name replaced by other letters")

    def _of_bag(self, path: Path) -> Step | None:
        if self._person.owns_label and self._is_theirs(path):
            return Step(path, Action.DELETE, "a bag of this person's recording")
        try:
            own, others = _topics_of(path, self._person)
        # The library raises many kinds of errors; an unreadable bag is reported.
        except Exception as error:  # noqa: BLE001 - any of a library's
            return Step(path, Action.LOOK, f"the bag cannot be read: {error}")
        if not own:
            return None
        if not others:
            return Step(path, Action.DELETE, "all its topics are this person's")
        return Step(path, Action.REWRITE, f"without {len(own)} of the person's topics")


@dataclass(frozen=True, slots=True)
class Done:
    """The result for one file."""

    path: Path
    action: Action
    # before, after: SHA-256 of the file; `after` is empty if it was deleted.
    before: str
    after: str = ""
    error: str = ""  # Why the step failed, as a sentence; empty if it succeeded.


@dataclass(frozen=True, slots=True)
class Left:
    """A file that still contains traces of the person."""

    path: Path
    what: str


@dataclass(frozen=True, slots=True)
class Report:
    """What was done, and the result of the search afterwards."""

    person: str
    done: tuple[Done, ...]
    looked_at: tuple[Step, ...]  # Files that the user must inspect.
    left: tuple[Left, ...]
    searched: int  # Number of files searched for names and pieces of the data.
    pieces: int  # Number of these pieces.

    @property
    def is_clean(self) -> bool:
        """Whether everything was done and nothing is left."""
        return not (self.left or self.looked_at or any(each.error for each in self.done))


def carry_out(plan: Plan) -> Report:
    """Execute a plan file by file, and search the remaining files."""
    person = Person(plan.person, shares_label=plan.shares_label)
    # What is deleted makes room for what is written again.
    steps = sorted(plan.steps, key=lambda each: each.action is not Action.DELETE)
    done = [each for step in steps if step.action is not Action.LOOK for each in _do(step, person)]
    looked_at = tuple(each for each in plan.steps if each.action is Action.LOOK)
    left: list[Left] = []
    searched = 0
    for place in plan.places:
        for path in _files(place):
            searched += 1
            left += [Left(path, what) for what in _found(path, person, plan.pieces)]
    return Report(
        plan.person, tuple(done), looked_at, tuple(left), searched, len(plan.pieces.found)
    )


def _do(step: Step, person: Person) -> Iterator[Done]:
    whole = _interrupted(step.path)
    if whole is not None and not whole.exists():
        # The bag gets its name back before it is rewritten.
        step = replace(step, path=step.path.rename(whole))
    files = list(_files(step.path))
    before: dict[Path, str] = {}
    try:
        before |= {path: digest(path) for path in files}
        if step.action is Action.REWRITE:
            _rewrite(step.path, person)
        elif step.path.is_dir():
            shutil.rmtree(step.path)
        else:
            step.path.unlink()
    # An error in one file must not stop the others; it is reported.
    except Exception as error:  # noqa: BLE001 - any of a library's
        yield Done(step.path, step.action, before.get(step.path, ""), error=_why(step, error))
        return
    for path in files:
        after = digest(path) if path.is_file() else ""
        yield Done(path, step.action, before[path], after)
    for path in _files(step.path) if step.path.exists() else ():
        if path not in before:
            yield Done(path, step.action, "", digest(path))


_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
_NOT_WRITTEN = frozenset({*_FULL, errno.EROFS, errno.EACCES, errno.EPERM, errno.EBUSY})


def _why(step: Step, error: Exception) -> str:
    """Return why a step failed; readers may report an error of writing as their own."""
    for each in (error, error.__cause__):
        if isinstance(each, OSError) and each.errno in _NOT_WRITTEN:
            is_full = each.errno in _FULL
            advice = "free some space on that disk, and give the command again: the rest is done"
            message = f"cannot write {step.path}: {each.strerror}; {advice}"
            return message if is_full else cannot_write(step.path, each)
    return str(error)


def _rewrite(path: Path, person: Person) -> None:
    """Write a temporary file and replace the original, so a complete file always exists."""
    write: Callable[[Path, Path, Person], None] = write_without
    if path.is_dir():
        write = _write_bag_without
    elif is_recording(path):
        write = recordings.write_without
    elif path.suffix.lower() in EDF:
        write = write_edf_without
    new = path.with_name(f".{path.name}.without")
    if path.is_dir():
        _rewrite_folder(path, new, partial(write, path, new, person))
        return
    new.unlink(missing_ok=True)
    try:
        write(path, new, person)
        new.replace(path)
    finally:
        # Another program may have the original open, so that it stays.
        new.unlink(missing_ok=True)


_OF_INTERRUPTED = re.compile(r"\.(?P<name>.+)\.(?P<kind>old|without|without\.made)")


def _interrupted(place: Path) -> Path | None:
    """Return the bag that was being rewritten when a withdrawal was interrupted.

    A program that is killed may leave the bag as it was, under another name, and parts of the new
    one; None for any other file or folder.
    """
    found = _OF_INTERRUPTED.fullmatch(place.name)
    if found is None or not place.is_dir():
        return None
    whole = place.with_name(found["name"])
    if found["kind"] == "old":
        return whole if _is_bag(place) else None
    before = place.with_name(f".{found['name']}.old")
    return next((each for each in (whole, before) if _is_bag(each)), None)


def _rewrite_folder(path: Path, new: Path, write: Callable[[], None]) -> None:
    shutil.rmtree(new, ignore_errors=True)
    old = path.with_name(f".{path.name}.old")
    try:
        write()
        # On Windows, a folder in which a file is open is not renamed, but deleted in part.
        path.rename(old)
        new.rename(path)
        shutil.rmtree(old)
    finally:
        shutil.rmtree(new, ignore_errors=True)
        if old.exists() and not path.exists():
            old.rename(path)


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    found = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            found.update(block)
    return found.hexdigest()


def _files(place: Path) -> Iterator[Path]:
    if place.is_dir():
        yield from sorted(each for each in place.rglob("*") if each.is_file())
    elif place.is_file():
        yield place


def _found(path: Path, person: Person, pieces: Pieces) -> Iterator[str]:
    if person.is_in(path.name):
        yield "its name"
    try:
        if _is_named(path, person):
            yield "the person's name"
        overlap = max(_LONGEST_NAME, pieces.longest)
        parts = blocks(_content(path), overlap)
        if any(map(pieces.in_bytes, parts)) or _has_values(path, pieces):
            yield "data of the person"
    except (OSError, EOFError, ValueError, RecordingError, BagError) as error:
        yield f"not known, because it cannot be read: {error}"


def _has_values(path: Path, pieces: Pieces) -> bool:
    """Whether a table or a signal has values of the person."""
    if path.suffix.lower() in EDF:
        return pieces.in_edf(path)
    if not (is_text(path) or path.suffix.lower() == ".gz"):
        return False
    with open_plain(path) as file:
        return pieces.in_rows(file)


def _is_named(path: Path, person: Person) -> bool:
    """Whether a text in a file names a person; numeric data is not searched."""
    if is_recording(path):
        return recordings.is_named(path, person)
    if path.suffix in _BAGS:
        return any(
            person.is_in_name(each.topic.name) or is_in_message(each.content, person)
            for each in read_bag(path, lambda _: None)
        )
    if path.suffix.lower() in EDF:
        return any(map(person.is_in_bytes, texts_of_edf(path)))
    if path.suffix in _NUMBERS:
        return False
    return any(map(person.is_in_bytes, blocks(_content(path), _LONGEST_NAME)))


def _content(path: Path) -> Iterator[bytes]:
    """Yield the contents of a file, decompressed."""
    if is_recording(path):
        with open_recording(path) as opened:
            yield from _blocks_of(opened.file)
    elif path.suffix in _BAGS:
        for message in read_bag(path, lambda _: None):
            yield message.content
    else:
        with open_plain(path) as file:
            yield from _blocks_of(file)


def _blocks_of(file: BinaryIO) -> Iterator[bytes]:
    file.seek(0)
    while block := file.read(_BLOCK_BYTES):
        yield block


def _is_bag(folder: Path) -> bool:
    """Whether a folder is a bag of ROS 2."""
    return (folder / _METADATA).is_file()


def _stream_of(path: Path) -> str:
    """Return the name of the stream of which a file of a data set is; empty if none is told."""
    sidecar = path.with_name(f"{path.name.partition('.')[0]}.json")
    if not ("_" in sidecar.stem and sidecar.is_file()):
        return ""
    try:
        with sidecar.open("rb") as file:
            content: Any = json.loads(file.read(LONGEST_JSON))
        return str(content["LslStream"]["Name"])
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def _recorded_as(folder: Path) -> str:
    """Return the participant of a folder of a data set; empty if its table has none."""
    try:
        rows = _rows_of(folder.parent / PARTICIPANTS)
    except (OSError, ValueError):
        return ""
    return next((each.get(CALLED) or "" for each in rows if each.get(ID) == folder.name), "")


def _topics_of(folder: Path, person: Person) -> tuple[list[str], int]:
    """Return a person's topics, and the number of other people's topics.

    Raises
    ------
    Exception
        Any of the library's, if it cannot be read.
    """
    with Reader(folder) as reader:
        names = list(dict.fromkeys(each.topic for each in reader.connections))
    own = [each for each in names if person.is_in_name(each)]
    return own, len(names) - len(own)


def _write_bag_without(folder: Path, target: Path, person: Person) -> None:
    """Copy it without the person's topics, and without messages that name them.

    Raises
    ------
    Exception
        Any of the library's, if it cannot be read or written.
    """
    plugin = StoragePlugin.SQLITE3 if list(folder.glob("*.db3*")) else StoragePlugin.MCAP
    # The library calls the file in it after the folder.
    place = target.with_name(f"{target.name}.made")
    made = place / folder.name
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    try:
        with Reader(folder) as reader, Writer(made, version=9, storage_plugin=plugin) as writer:
            given: dict[int, Connection] = {}
            for each in reader.connections:
                if person.is_in_name(each.topic):
                    continue
                qos = getattr(each.ext, "offered_qos_profiles", [])
                given[each.id] = writer.add_connection(
                    each.topic,
                    each.msgtype,
                    msgdef=each.msgdef.data,
                    rihs01=each.digest,
                    offered_qos_profiles=qos,
                )
            for connection, unix_ns, content in reader.messages():
                kept = given.get(connection.id)
                if kept is not None and not is_in_message(content, person):
                    writer.write(kept, unix_ns, content)
        _copy_others(folder, made, person)
        made.rename(target)
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _copy_others(folder: Path, made: Path, person: Person) -> None:
    """Copy what is in a bag besides its data, such as a README."""
    for path in folder.iterdir():
        new = made / path.name
        if path.suffix in _BAGS or path.name == _METADATA or not path.is_file():
            continue
        if is_text(path) and not is_utf16(path):
            write_without(path, new, person)
        else:
            shutil.copy2(path, new)
