"""Adds recordings to the dataset of a study one by one, without overwriting anything.

Each recording is first written as a separate dataset next to it and then moved into it. Added
recordings are listed in ``sourcedata``, where BIDS allows any file, so that the same command can
be repeated to continue after an interruption.
"""

from __future__ import annotations

import csv
import filecmp
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

from biosensor_common.errors import ConfigError, ConfigReason, cannot_write
from biosensor_gateway.recording.export.bids.dataset import BIDS_VERSION, README
from biosensor_gateway.recording.export.bids.file_names import NOTHING, line, write_json, write_text
from biosensor_gateway.recording.export.outcome import Outcome
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

_DESCRIPTION, PARTICIPANTS = "dataset_description.json", "participants.tsv"
ID, CALLED = "participant_id", "recorded_as"
ADDED = Path("sourcedata") / "recordings.tsv"
_ADDED_COLUMNS = ("recording", "sha256")
_ZERO = "TimeZero"
_OF_A_RUN = frozenset({"sub", "ses", "task", "acq", "run"})
_BLOCK_BYTES = 1 << 20
Table = list[dict[str, str]]


def is_dataset(folder: Path) -> bool:
    """Whether a folder contains a BIDS dataset."""
    return (folder / _DESCRIPTION).is_file()


class Study:
    """The dataset of a study.

    Parameters
    ----------
    root
        Its folder; created with the first recording.

    Raises
    ------
    ConfigError
        ``EXISTS``, if the folder contains something else.
    """

    def __init__(self, root: Path) -> None:
        is_empty = root.is_dir() and not any(root.iterdir())
        if os.path.lexists(root) and not is_dataset(root) and not is_empty:
            message = (
                f"{root} is not a BIDS data set; give a new folder, or the folder of a data set"
            )
            raise ConfigError(ConfigReason.EXISTS, message)
        self._root = root

    def add(self, recording: Path, export_to: Callable[[Path], Outcome]) -> Outcome | None:
        """Add a recording; return the outcome, None if it was added before.

        Raises
        ------
        RecordingError
            ``UNWRITABLE``, if its participant is undecided, one of its files or its run exists from
            another recording, its label belongs to another participant in the dataset, or the
            dataset cannot be read or written; nothing is added then.
        """
        digest = _digest(recording)
        try:
            for added in _read_table(self._root / ADDED):
                if (added.get("recording"), added.get("sha256")) == (recording.name, digest):
                    return None
            with self._workshop() as workshop:
                made = workshop / self._root.name
                outcome = export_to(made)
                self._require_name(outcome)
                self._require_room(made, recording)
                count = self._move_in(made)
            # An incomplete recording is not noted as added, so it is reported again.
            if outcome.is_whole:
                self._note(recording.name, digest)
        except OSError as error:
            # A file that another program has open is named, such as a table in a spreadsheet.
            message = cannot_write(error.filename2 or self._root, error)
            raise RecordingError(RecordingReason.UNWRITABLE, message) from error
        told = "1 file was added" if count == 1 else f"{count} files were added"
        written = tuple(
            replace(each, path=self._root, notes=(*each.notes, told)) for each in outcome.written
        )
        return replace(outcome, written=written)

    @contextmanager
    def _workshop(self) -> Generator[Path]:
        folder = self._root.with_name(f"{self._root.name}.{os.getpid()}.part")
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(0o700, parents=True)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _require_name(self, outcome: Outcome) -> None:
        if outcome.mismatch is not None:
            message = (
                f"{outcome.path}: {outcome.mismatch.sentence}; it is not added until --whose "
                "says which is right"
            )
            raise RecordingError(RecordingReason.UNWRITABLE, message)

    def _require_room(self, made: Path, recording: Path) -> None:
        self._require_people(made, recording)
        # Ignoring case, because on disks of Windows and macOS the dataset would be mixed.
        there = {str(each).casefold(): each for each in self._files()}
        for file in _data_of(made):
            name = file.relative_to(made)
            known = there.get(str(name).casefold())
            # Equal files were left behind by an interrupted attempt with the same recording.
            if known and (
                known != name or not filecmp.cmp(file, self._root / known, shallow=False)
            ):
                raise _in_the_way(recording, known)
        # Files of different sensors have different names even if they are of two recordings.
        zeros = {_run_of(name): zero for name, zero in _zeros(made)}
        for name, zero in _zeros(self._root, zeros):
            if zero != zeros[_run_of(name)]:
                raise _in_the_way(recording, name)

    def _files(self) -> Iterator[Path]:
        if self._root.is_dir():
            yield from (each.relative_to(self._root) for each in _data_of(self._root))

    def _require_people(self, made: Path, recording: Path) -> None:
        there = {
            each.get(ID, "").casefold(): each for each in _read_table(self._root / PARTICIPANTS)
        }
        for person in _read_table(made / PARTICIPANTS):
            known = there.get(person[ID].casefold(), person)
            called = known.get(CALLED, "")
            if known[ID] != person[ID] or called not in {person[CALLED], NOTHING, ""}:
                message = (
                    f"{recording}: {known[ID]} is {called!r} in the data set and "
                    f"{person[CALLED]!r} in this recording; BIDS has no place for both"
                )
                raise RecordingError(RecordingReason.UNWRITABLE, message)

    def _move_in(self, made: Path) -> int:
        self._root.mkdir(parents=True, exist_ok=True)
        if not is_dataset(self._root):
            self._describe()
        # First, because the table of participants is what people have open.
        self._add_people(_read_table(made / PARTICIPANTS), made)
        files = list(_data_of(made))
        for file in files:
            place = self._root / file.relative_to(made)
            place.parent.mkdir(parents=True, exist_ok=True)
            file.replace(place)
        return len(files)

    def _describe(self) -> None:
        gateway = version("biosensor-gateway")
        description = {
            "Name": self._root.name,
            "BIDSVersion": BIDS_VERSION,
            "DatasetType": "raw",
            "GeneratedBy": [{"Name": "biosensor-gateway", "Version": gateway}],
        }
        if not (self._root / "README.md").exists():
            text = README.format(name=self._root.name, version=gateway)
            write_text(self._root / "README.md", text)
        # Written last, because this file marks the folder as a dataset.
        write_json(self._root / _DESCRIPTION, description)

    def _add_people(self, people: Table, made: Path) -> None:
        """Add rows; columns and rows that the user added are kept."""
        path = self._root / PARTICIPANTS
        rows = _read_table(path)
        columns = list(rows[0]) if rows else [ID, CALLED]
        if CALLED not in columns:
            columns.append(CALLED)
        known = {each.get(ID) for each in rows}
        rows += [each for each in people if each[ID] not in known]
        text = line(columns) + "".join(
            line([each.get(column) or NOTHING for column in columns]) for each in rows
        )
        _replace(path, text)
        sidecar = self._root / "participants.json"
        if not sidecar.exists():
            shutil.copyfile(made / "participants.json", sidecar)

    def _note(self, name: str, digest: str) -> None:
        rows = _read_table(self._root / ADDED)
        cells = ([each.get(column) or NOTHING for column in _ADDED_COLUMNS] for each in rows)
        lines = [line(_ADDED_COLUMNS), *map(line, cells)]
        (self._root / ADDED).parent.mkdir(exist_ok=True)
        _replace(self._root / ADDED, "".join([*lines, line([name, digest])]))


def _in_the_way(recording: Path, name: Path) -> RecordingError:
    message = (
        f"{recording}: {name} is already in the data set, from another recording; export it with "
        "another --session or --task, or alone"
    )
    return RecordingError(RecordingReason.UNWRITABLE, message)


def _run_of(name: Path) -> frozenset[str]:
    """Return the part of a file's name that is common to all files of one recording."""
    parts = name.name.casefold().split("_")
    return frozenset(each for each in parts if each.partition("-")[0] in _OF_A_RUN)


def _zeros(
    root: Path, runs: Collection[frozenset[str]] | None = None
) -> Iterator[tuple[Path, object]]:
    """Yield the time zero of each sidecar that has one, which is the same in all of a recording.

    Parameters
    ----------
    runs
        If given, other runs are left out.
    """
    for path in sorted(root.glob("sub-*/**/*.json")):
        if runs is not None and _run_of(path) not in runs:
            continue
        try:
            content = json.loads(path.read_bytes())
        except ValueError:
            # It is not of this program.
            continue
        if isinstance(content, dict) and _ZERO in content:
            yield path.relative_to(root), content[_ZERO]


def _data_of(made: Path) -> Iterator[Path]:
    yield from (each for each in sorted(made.rglob("*")) if each.is_file() and each.parent != made)


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(_BLOCK_BYTES):
                digest.update(block)
    except OSError:
        # The export itself reports why it cannot be read.
        return ""
    return digest.hexdigest()


def _read_table(path: Path) -> Table:
    """Return the rows of a table; none if the file does not exist.

    Raises
    ------
    OSError
        If it cannot be read.
    RecordingError
        ``UNWRITABLE``, if it is not a valid text table.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))
    except FileNotFoundError:
        return []
    except (UnicodeDecodeError, csv.Error) as error:
        message = f"{path} cannot be read, so nothing is added: save it as text with tabs, in UTF-8"
        raise RecordingError(RecordingReason.UNWRITABLE, message) from error


def _replace(path: Path, text: str) -> None:
    new = path.with_name(f".{path.name}.new")
    new.unlink(missing_ok=True)
    try:
        write_text(new, text)
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)
