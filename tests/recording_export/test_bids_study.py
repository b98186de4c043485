"""Recordings of a study become one data set, which is never overwritten."""

from __future__ import annotations

import csv
import hashlib
import struct
from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError
from biosensor_gateway.recording.contents.choice import Wish
from biosensor_gateway.recording.export.bids.study import ADDED, Study
from biosensor_gateway.recording.export.exporting import Task, export
from biosensor_gateway.recording.export.outcome import Outcome
from biosensor_gateway.recording.export.several import recordings_in
from biosensor_gateway.recording.participants import Whose
from biosensor_gateway.recording.xdf.container import RecordingError
from tests.recording_export.bids_shapes import h10
from tests.xdf import xdf_file as made


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / "dataset"


def _recording(folder: Path, person: str, name: str = "", count: int = 0) -> Path:
    path = folder / (name or f"sub-{person}_task-walk_run-001_beh.xdf")
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_bytes(made.xdf(h10(1 + count, person)))
    return path


def _add(root: Path, recording: Path, whose: Whose | None = None) -> Outcome | None:
    def export_to(place: Path) -> Outcome:
        task = Task(("bids",), Wish(), output=place, whose=whose)
        return export(recording, task, lambda _name, _s: lambda _done: None)

    return Study(root).add(recording, export_to)


def _people(root: Path) -> dict[str, dict[str, str]]:
    with (root / "participants.tsv").open(newline="") as file:
        return {each["participant_id"]: each for each in csv.DictReader(file, delimiter="\t")}


def _files(root: Path) -> dict[str, str]:
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


def test_thirty_recordings_become_one_dataset(tmp_path: Path, root: Path) -> None:
    people = [f"P{number:02}" for number in range(1, 31)]
    for person in people:
        assert _add(root, _recording(tmp_path, person)) is not None
    assert list(_people(root)) == [f"sub-{person}" for person in people]
    assert sorted(each.name for each in root.glob("sub-*")) == list(_people(root))
    assert [each.name for each in root.rglob("dataset_description.json")] == [
        "dataset_description.json"
    ]
    assert [each.name for each in tmp_path.iterdir() if each.suffix == ".part"] == []


def test_what_was_added_is_not_added_again(tmp_path: Path, root: Path) -> None:
    recording = _recording(tmp_path, "P01")
    _add(root, recording)
    before = _files(root)
    assert _add(root, recording) is None
    assert _files(root) == before


def test_an_interrupted_addition_goes_on(
    tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = _recording(tmp_path, "P01"), _recording(tmp_path, "P02")
    _add(root, first)
    expected = tmp_path / "expected"
    for each in (first, second):
        _add(expected, each)
    real, moved = Path.replace, 0

    def replace(path: Path, target: Path) -> Path:
        nonlocal moved
        moved += 1
        if moved > 2:
            raise OSError(28, "No space left on device")
        return real(path, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", replace)
        with pytest.raises(RecordingError, match="No space left on device"):
            _add(root, second)
    assert _add(root, second) is not None
    left = {name for name in _files(root) if name != "dataset_description.json"}
    assert left == {name for name in _files(expected) if name != "dataset_description.json"}


def test_files_of_another_recording_are_not_overwritten(tmp_path: Path, root: Path) -> None:
    _add(root, _recording(tmp_path, "P01"))
    before = _files(root)
    # Of the same name and person, recorded on another day.
    other = _recording(tmp_path / "other", "P01")
    other.write_bytes(other.read_bytes().replace(struct.pack("<f", 1.0), struct.pack("<f", 2.0)))
    with pytest.raises(RecordingError, match=r"is in the data set already, of another recording"):
        _add(root, other)
    assert _files(root) == before


def test_two_people_of_one_label_are_not_mixed(tmp_path: Path, root: Path) -> None:
    _add(root, _recording(tmp_path, "P-01", "one_task-walk.xdf"))
    with pytest.raises(RecordingError, match=r"'P-01' in the data set and 'P01' in this"):
        _add(root, _recording(tmp_path, "P01", "two_task-talk.xdf"))


def test_what_a_person_adds_to_the_table_stays(tmp_path: Path, root: Path) -> None:
    _add(root, _recording(tmp_path, "P01"))
    table = root / "participants.tsv"
    table.write_text("participant_id\tage\trecorded_as\nsub-P01\t34\tP01\nsub-P09\t29\tn/a\n")
    (root / "README.md").write_text("Our study.\n")
    _add(root, _recording(tmp_path, "P02"))
    people = _people(root)
    assert [people[each]["age"] for each in people] == ["34", "29", "n/a"]
    assert people["sub-P02"]["recorded_as"] == "P02"
    assert (root / "README.md").read_text() == "Our study.\n"


def test_a_folder_of_something_else_is_no_study(tmp_path: Path, root: Path) -> None:
    root.mkdir()
    (root / "notes.txt").write_text("mine\n")
    with pytest.raises(ConfigError, match="is no BIDS data set"):
        Study(root)
    assert not (root / ADDED).exists()


def test_recordings_of_folders_are_found_salvaged_ones_in_place_of_broken(tmp_path: Path) -> None:
    paths = [_recording(tmp_path / "a", f"P{number:02}") for number in (2, 1)]
    broken = paths[0]
    salvaged = broken.with_name(f"{broken.stem}_salvaged.xdf")
    salvaged.write_bytes(broken.read_bytes())
    (tmp_path / "a" / "notes.txt").touch()
    assert recordings_in([tmp_path]) == ([paths[1], salvaged], [broken])
    assert recordings_in([broken, tmp_path]) == ([broken, paths[1], salvaged], [broken])
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match="there is no recording"):
        recordings_in([tmp_path / "empty"])


def test_nobodys_data_is_added_under_a_name_that_is_a_guess(tmp_path: Path, root: Path) -> None:
    recording = _recording(tmp_path, "P01", "sub-P09_task-walk_run-001_beh.xdf")
    with pytest.raises(RecordingError, match=r"P09.*P01.*--whose"):
        _add(root, recording)
    assert not root.exists()
    assert _add(root, recording, Whose.SENSORS) is not None
    assert list(_people(root)) == ["sub-P01"]


def test_what_is_not_whole_is_said_each_time(tmp_path: Path, root: Path) -> None:
    recording = _recording(tmp_path, "P01")
    recording.write_bytes(recording.read_bytes()[:-40])
    for _ in range(2):
        outcome = _add(root, recording)
        assert outcome is not None
        assert not outcome.is_whole


@pytest.mark.parametrize("encoding", ["utf-16", "cp1252"])
def test_a_table_that_is_no_text_is_not_written_over(
    encoding: str, tmp_path: Path, root: Path
) -> None:
    _add(root, _recording(tmp_path, "P01"))
    table = root / "participants.tsv"
    table.write_text("participant_id\tname\nsub-P01\tM\u00fcller\n", encoding)
    before = _files(root)
    with pytest.raises(RecordingError, match=r"participants\.tsv cannot be read.*UTF-8"):
        _add(root, _recording(tmp_path, "P02"))
    assert _files(root) == before
