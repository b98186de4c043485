"""One person is taken out of a study: of every file, and nobody else loses a sample by it."""

from __future__ import annotations

import csv
import gzip
import json
import shutil
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from typer import Typer
from typer.testing import CliRunner

from biosensor_common.naming import label
from biosensor_gateway.cli.withdraw import withdraw
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.export.bids.study import Study
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.export.outcome import Outcome
from biosensor_gateway.recording.withdrawal.traces import Person
from biosensor_gateway.recording.withdrawal.work import (
    Action,
    Plan,
    Report,
    carry_out,
    digest,
    plan,
)
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.verdict import judge
from tests.recording_export.study import BEGIN_S, ecg_values, ours
from tests.rigs.open_elsewhere import SENTENCE, hold_open
from tests.xdf import xdf_file as made

GONE, STAYS = "P07", "P08"
FORMATS = ("csv", "csv-long.gz", "edf", "kubios", "mcap")


def _together() -> bytes:
    stamps = BEGIN_S + np.arange(1300) / 130
    texts = [
        [json.dumps({"event": "off_body", "participant": GONE, "sensor": "polar_h10"})],
        [json.dumps({"event": "heartbeat", "devices": {f"{GONE}@polar_h10": "ok", "b": "ok"}})],
        [json.dumps({"event": "off_body", "participant": STAYS, "sensor": "polar_h10"})],
    ]
    moments = [BEGIN_S + each for each in (1.0, 2.0, 3.0)]
    told = [["go"], [f"{GONE} stands up"], ["P071 is somebody else"]]
    return made.xdf(
        ours(1, "polar_h10", "ecg", ecg_values(1300, 1), stamps, GONE) + made.footer(1, 1300),
        ours(2, "polar_h10", "ecg", ecg_values(1300, 2), stamps, STAYS) + made.footer(2, 1300),
        ours(3, "gateway", "events", texts, moments, "") + made.footer(3, 3),
        made.stream_header(4, "PsychoPy", kind="Markers", fmt="string")
        + made.samples(4, "string", told, moments)
        + made.footer(4, 3),
    )


def _alone(name: str, seed: int) -> bytes:
    stamps = BEGIN_S + np.arange(650) / 130
    return made.xdf(ours(1, "polar_h10", "ecg", ecg_values(650, seed), stamps, name))


def _export(path: Path, *formats: str, output: Path | None = None) -> Outcome:
    return export(
        path, Task(formats, Selection(), output=output), lambda _n, _s: lambda _done: None
    )


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """A folder with all that there can be of a person, and of another."""
    root = tmp_path / "study"
    root.mkdir()
    recordings = {
        "together.xdf": _together(),
        f"sub-{GONE}_task-walk_beh.xdf": _alone(GONE, 3),
        f"sub-{GONE}_task-walk_beh_salvaged.xdf": _alone(GONE, 3),
        f"sub-{STAYS}_task-walk_beh.xdf": _alone(STAYS, 4),
    }
    for name, content in recordings.items():
        (root / name).write_bytes(content)
    (root / "packed.xdf.gz").write_bytes(gzip.compress(_together()))
    _export(root / "together.xdf", *FORMATS, "bids")
    dataset = Study(root / "dataset")
    for path in (root / f"sub-{each}_task-walk_beh.xdf" for each in (GONE, STAYS)):

        def export_to(place: Path, path: Path = path) -> Outcome:
            return _export(path, "bids", output=place)

        dataset.add(path, export_to)
    (root / "notes.txt").write_text(f"{STAYS} slept well\n{GONE} had a cold\n")
    (root / f"{GONE}_consent.pdf").write_bytes(b"%PDF")
    return root


def _values(path: Path, name: str) -> NDArray[np.float32]:
    with open_contents(path) as contents:
        (stream,) = (each for each in contents.streams if name in each.header.name)
        return np.concatenate([np.asarray(each.values) for each in stream.blocks()])


def _withdrawn(root: Path) -> tuple[Plan, Report]:
    found = plan(GONE, [root])
    return found, carry_out(found)


def test_nothing_is_left_and_nobody_else_loses_a_sample(study: Path) -> None:
    consent = study / f"{GONE}_consent.pdf"
    found, report = _withdrawn(study)
    assert [each for each in report.done if each.error] == []
    # What is of no known kind is a person's to decide.
    assert [each.path for each in report.looked_at] == [consent]
    assert [each.path for each in report.left] == [consent]
    consent.unlink()
    again = carry_out(plan(GONE, [study]))
    assert again.is_clean
    assert again.done == ()
    assert report.pieces > 10
    assert found.files > 30

    for name in ("together.xdf", "packed.xdf.gz"):
        with open_contents(study / name) as contents:
            names = [each.header.name for each in contents.streams]
        assert names == [f"{STAYS}-polar_h10-U1-ecg", "gateway-U1-events", "PsychoPy"]
        values = _values(study / name, f"{STAYS}-")
        assert values.tobytes() == ecg_values(1300, 2).tobytes()
        report_of = judge(read_recording(study / name))
        assert not report_of.recording.damages
        assert not {"footer-count", "no-footer"} & {each.code for each in report_of.findings}
    alone = study / f"sub-{STAYS}_task-walk_beh.xdf"
    assert _values(alone, "ecg").tobytes() == ecg_values(650, 4).tobytes()
    assert not list(study.rglob(f"*{GONE}*"))
    assert (study / "notes.txt").read_text() == f"{STAYS} slept well\n"
    people = (study / "dataset" / "participants.tsv").read_text()
    assert f"sub-{STAYS}" in people
    assert f"sub-{STAYS}" in (study / "dataset" / "sourcedata" / "recordings.tsv").read_text()
    assert list((study / "dataset" / f"sub-{STAYS}").rglob("*ecg_physio.tsv.gz"))


def test_of_tables_of_several_people_the_columns_go_and_every_row_stays(tmp_path: Path) -> None:
    (tmp_path / "together.xdf").write_bytes(_together())
    task = Task(("csv",), Selection(), is_wide=True)
    export(tmp_path / "together.xdf", task, lambda _n, _s: lambda _done: None)
    table = tmp_path / "together_csv" / "all_130Hz.csv"
    before = list(csv.reader(table.read_text().splitlines()))
    _, report = _withdrawn(tmp_path)
    assert report.is_clean
    after = list(csv.reader(table.read_text().splitlines()))
    (gone,) = (at for at, head in enumerate(before[0]) if GONE in head)
    assert len(after) == len(before)
    assert [row[:gone] + row[gone + 1 : -1] for row in before] == [row[:-1] for row in after]
    markers = {row[-1] for row in after}
    assert {"withdrawn stands up", "P071 is somebody else"} <= markers


def _of_a_stranger(name: str) -> bytes:
    """A stream of another program, whose header does not say who wore the sensor."""
    stamps = BEGIN_S + np.arange(650) / 130
    values = np.random.default_rng(7).normal(size=(650, 1)).astype(np.float32)
    return made.xdf(
        made.stream_header(1, name, kind="ECG", rate=130.0),
        made.samples(1, "float32", values.tolist(), stamps.tolist()),
        made.footer(1, 650),
    )


def test_tables_of_a_stream_named_after_the_person_go_where_the_file_name_hides_it(
    tmp_path: Path,
) -> None:
    (tmp_path / "session.xdf").write_bytes(_of_a_stranger(f"{GONE}_Chest"))
    _export(tmp_path / "session.xdf", "bids")
    assert list(tmp_path.rglob(f"*recording-{GONE}Chest_physio.tsv.gz"))
    found, _ = _withdrawn(tmp_path)
    deleted = [each.path.suffix for each in found.steps if each.action is Action.DELETE]
    assert sorted(deleted) == [".gz", ".json", ".xdf"]
    assert not list(tmp_path.rglob("*_physio.*"))


EVERY_FORMAT = {
    "csv": (".csv",),
    "csv.gz": (".csv.gz",),
    "csv-long": (".csv",),
    "csv-long.gz": (".csv.gz",),
    "edf": (".bdf",),
    "kubios": (".txt",),
    "ledalab": (".txt",),
    "mcap": (".mcap",),
    "bids": (".tsv.gz", ".eeg"),
}


@pytest.mark.parametrize("kind", ["float32", "double64", "int16", "three channels", "held"])
@pytest.mark.parametrize("form", [*EVERY_FORMAT, "wide csv", "db3"])
def test_data_in_any_format_is_found_where_no_name_tells_whose_it_is(
    form: str, kind: str, tmp_path: Path
) -> None:
    channels = 3 if kind == "three channels" else 1
    values = np.cumsum(np.random.default_rng(7).normal(size=(650, channels)) * 40, axis=0)
    if kind == "held":
        values = np.repeat(values[::2], 2, axis=0)
    fmt = kind if kind in {"double64", "int16"} else "float32"
    rows = np.round(values).astype(int) if fmt == "int16" else values.astype(np.dtype(fmt[:-2]))
    stamps = BEGIN_S + np.arange(650) / 130
    skin = form == "ledalab"
    header = made.stream_header(
        1, "Skin" if skin else "Chest", kind="GSR" if skin else "ECG", rate=130.0, fmt=fmt,
        channels=channels,
    )  # fmt: skip
    chunks = [
        made.samples(1, fmt, rows[at : at + 65].tolist(), stamps[at : at + 65].tolist())
        for at in range(0, 650, 65)
    ]
    path = tmp_path / f"{GONE}.xdf"
    path.write_bytes(made.xdf(header, *chunks, made.footer(1, 650)))
    study, other = tmp_path / "study", tmp_path / "other"
    study.mkdir()
    other.mkdir()
    name = {"wide csv": "csv", "db3": "mcap"}.get(form, form)
    task = Task((name,), Selection(), is_wide=form == "wide csv", output=other)
    made_of = export(path, task, lambda _n, _s: lambda _done: None).written[0].path
    if form == "db3":
        made_of = _as_sqlite(made_of, other / "db3")
    path.rename(study / path.name)
    # A text or a name in what was exported would be found without the data.
    ends = EVERY_FORMAT.get(form, (".db3",) if form == "db3" else (".csv",))
    inside = made_of.rglob("*") if made_of.is_dir() else [made_of]
    data = [each for each in inside if each.name.endswith(ends) and each.name != "README.txt"]
    for number, each in enumerate(data):
        each.rename(study / f"session_{number}{''.join(each.suffixes[-2:])}")
    assert data
    report = carry_out(plan(GONE, [study]))
    assert not (study / path.name).exists()
    assert "data of the person" in {each.what for each in report.left}
    assert {each.path.name for each in report.left} <= {each.name for each in study.iterdir()}


def _as_sqlite(bag: Path, target: Path) -> Path:
    """A bag as ROS 2 wrote it before Iron."""
    with (
        Reader(bag) as reader,
        Writer(target, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer,
    ):
        given = {
            each.id: writer.add_connection(
                each.topic, each.msgtype, msgdef=each.msgdef.data, rihs01=each.digest
            )
            for each in reader.connections
        }
        for connection, unix_ns, content in reader.messages():
            writer.write(given[connection.id], unix_ns, content)
    return target


def test_data_of_others_is_not_called_the_person_s(tmp_path: Path) -> None:
    """Of two people with the same kind of signal in all formats."""
    (tmp_path / f"{GONE}.xdf").write_bytes(_of_a_stranger("Chest"))
    stamps = BEGIN_S + np.arange(13_000) / 130
    values = np.random.default_rng(8).normal(size=(13_000, 1)).astype(np.float32)
    other = tmp_path / "session.xdf"
    other.write_bytes(
        made.xdf(
            made.stream_header(1, "Chest", kind="ECG", rate=130.0),
            made.samples(1, "float32", values.tolist(), stamps.tolist()),
            made.footer(1, 13_000),
        )
    )
    _export(other, *FORMATS, "bids")
    assert carry_out(plan(GONE, [tmp_path])).is_clean


@pytest.mark.parametrize("has_others", [False, True])
def test_a_folder_named_after_the_person_goes_or_is_left_to_a_person(
    tmp_path: Path, has_others: bool
) -> None:
    folder = tmp_path / f"{GONE} monday"
    folder.mkdir()
    (folder / f"{GONE}.xdf").write_bytes(_of_a_stranger("Chest"))
    if has_others:
        (folder / "session.xdf").write_bytes(_of_a_stranger("Chest"))
    _, report = _withdrawn(tmp_path)
    assert folder.exists() == has_others
    assert not (folder / f"{GONE}.xdf").exists()
    assert [each.path for each in report.looked_at] == [folder] * has_others
    assert report.is_clean != has_others
    # Whoever asks for a folder of this name has not said that all in it goes.
    if has_others:
        assert carry_out(plan(GONE, [folder])).looked_at == ()


@pytest.mark.parametrize("gone", [GONE, STAYS])
def test_of_joined_recordings_each_person_has_their_own(tmp_path: Path, gone: str) -> None:
    """Both use number 1; the second one's samples are not the first one's."""
    path = tmp_path / "joined.xdf"
    path.write_bytes(_alone(GONE, 3) + _alone(STAYS, 4))
    assert carry_out(plan(gone, [tmp_path])).is_clean
    (left, seed) = (STAYS, 4) if gone == GONE else (GONE, 3)
    with open_contents(path) as contents:
        assert [each.header.name for each in contents.streams] == [f"{left}-polar_h10-U1-ecg"]
    assert _values(path, "ecg").tobytes() == ecg_values(650, seed).tobytes()


def test_what_others_said_stays_without_the_name(study: Path) -> None:
    _withdrawn(study)
    with open_contents(study / "together.xdf") as contents:
        texts = {
            each.header.name: [
                row[0]
                for samples in each.blocks()
                if isinstance(samples.values, list)
                for row in samples.values
            ]
            for each in contents.streams
        }
    assert texts["PsychoPy"] == ["go", "withdrawn stands up", "P071 is somebody else"]
    events = [json.loads(each) for each in texts["gateway-U1-events"]]
    assert [each.get("participant") for each in events] == [None, STAYS]
    assert events[0]["devices"] == {"b": "ok"}


def test_the_report_has_the_hash_of_each_file_before_and_after(study: Path) -> None:
    before = {path: digest(path) for path in study.rglob("*") if path.is_file()}
    _, report = _withdrawn(study)
    told = {each.path: each for each in report.done}
    for path, was in before.items():
        now = digest(path) if path.is_file() else ""
        if now != was:
            assert (told[path].before, told[path].after) == (was, now), path
    assert {each.path for each in report.done if not each.before} <= {*study.rglob("*")}


HIDDEN = {
    "copy.dat": _alone(GONE, 3),
    "copy.bin": b"xx" + ecg_values(650, 3).tobytes(),
    "copy.gz": gzip.compress(ecg_values(1300, 1).tobytes()),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_the_search_finds_what_no_plan_knew(study: Path, name: str) -> None:
    (study / name).write_bytes(HIDDEN[name])
    (study / f"{GONE}_consent.pdf").unlink()
    _, report = _withdrawn(study)
    assert not report.is_clean
    assert {each.path.stem for each in report.left} == {"copy"}


def test_a_recording_of_another_name_than_its_sensors_is_left_to_a_person(tmp_path: Path) -> None:
    path = tmp_path / f"sub-{GONE}_beh.xdf"
    path.write_bytes(_alone(STAYS, 5))
    found = plan(GONE, [tmp_path])
    assert [(each.path, each.action) for each in found.steps] == [(path, Action.LOOK)]
    assert not carry_out(found).is_clean
    assert path.read_bytes() == _alone(STAYS, 5)


@pytest.mark.parametrize("name", ["together.xdf", "notes.txt", "together_bag", "packed.xdf.gz"])
def test_what_another_program_has_open_stays_as_it_is_and_is_told(
    study: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = study / name
    files = [path] if path.is_file() else sorted(path.iterdir())
    before = {each: each.read_bytes() for each in files}
    found = plan(GONE, [path])
    hold_open(monkeypatch, files[0])
    report = carry_out(found)
    monkeypatch.undo()
    (undone,) = (each for each in report.done if each.error)
    assert undone.error.startswith(f"cannot write {path}: ")
    assert undone.error.endswith(SENTENCE)
    assert not report.is_clean
    assert {each: each.read_bytes() for each in files} == before
    assert not [each for each in study.iterdir() if each.name.startswith(".")]
    # Once it is closed, the rest is done.
    assert _withdrawn(path)[1].is_clean


def test_names_that_only_hold_it_are_others() -> None:
    person = Person("P07")
    assert person.is_in("sub-P07_task")
    assert person.is_in("P07@polar_h10-ecg")
    assert not person.is_in("P071")
    assert not person.is_in("xP07")


NEAR = {
    "P1": ["P10", "P11", "XP1"],
    "p-1": ["p1", "p-10"],
    "Müller": ["Muller", "Müllerin"],
    "Jö": ["Jo", "Jörg"],
    "Ann": ["Annä", "Anna"],
    "山田": ["山田太郎", "田中"],
}


def _spelt(name: str) -> list[str]:
    """Return markers with a name in ways in which programs write it."""
    return [
        f"{name} sits",
        f"{unicodedata.normalize('NFD', name)} stands",
        f"{name.upper()} in capitals",
        f"x_{name}_y",
    ]


@pytest.mark.parametrize("gone", NEAR)
def test_all_spellings_of_a_name_go_and_names_that_are_alike_stay(
    gone: str, tmp_path: Path
) -> None:
    others, stamps = NEAR[gone], BEGIN_S + np.arange(1300) / 130
    signals = b"".join(
        ours(number, "polar_h10", "ecg", ecg_values(1300, number), stamps, each)
        + made.footer(number, 1300)
        for number, each in enumerate([gone, *others], 1)
    )
    told = [*_spelt(gone), *(f"{each} goes" for each in others)]
    markers = made.stream_header(9, "PsychoPy", kind="Markers", fmt="string") + made.samples(
        9, "string", [[each] for each in told], [BEGIN_S + 1 + at / 10 for at in range(len(told))]
    )
    path = tmp_path / "all.xdf"
    path.write_bytes(made.xdf(signals, markers))
    for name in (*FORMATS, "bids"):
        _export(path, name)
    for number, each in enumerate(others):
        (tmp_path / f"{each}.xdf").write_bytes(_alone(each, 20 + number))
        (tmp_path / f"{each}.txt").write_text(f"{each} slept well\n", "utf-8")
    people = [gone, *others]
    escaped = json.dumps({"devices": [{"participant": each} for each in people], "last": gone})
    (tmp_path / "status.json").write_text(escaped)
    lines = [f"{each}: connected\n" for each in people]
    (tmp_path / "agent.log").write_text("".join(lines), "utf-8")
    (tmp_path / "old.txt").write_bytes("".join(lines[:2]).encode("cp1252", "replace"))
    kept = {
        each: each.read_bytes()
        for name in others
        for each in (tmp_path / f"{name}.xdf", tmp_path / f"{name}.txt")
    }

    report = carry_out(plan(gone, [tmp_path]))
    assert [each for each in report.done if each.error] == []
    assert report.left == ()
    # Who has the same label may be the same person, and only a person can say.
    alike = [each for each in others if label(each).lower() == label(gone).lower()]
    assert [each.path.stem for each in report.looked_at] == alike
    assert {each: each.read_bytes() for each in kept} == kept
    with open_contents(path) as contents:
        worn = [each.header.identity for each in contents.streams]
        texts = [
            text
            for stream in contents.streams
            if stream.header.is_markers
            for block in stream.blocks()
            for (text,) in block.values
        ]
    assert [each.participant for each in worn if each is not None] == others
    assert texts[:4] == [
        "withdrawn sits",
        "withdrawn stands",
        "withdrawn in capitals",
        "x_withdrawn_y",
    ]
    assert texts[4:] == [f"{each} goes" for each in others]
    assert (tmp_path / "agent.log").read_text("utf-8") == "".join(lines[1:])
    devices = json.loads((tmp_path / "status.json").read_text("utf-8"))["devices"]
    assert [each["participant"] for each in devices] == others
    # Of each of the others, and of nobody else, an EDF file and the table of a topic are left.
    assert len(list((tmp_path / "all_edf").glob("*.bdf"))) == len(others)
    assert [each.name for each in (tmp_path / "all_bag").glob("*.mcap")] == ["all_bag.mcap"]


def test_a_text_in_utf_16_is_left_to_a_person(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text(f"{GONE} had a cold\n", "utf-16")
    (tmp_path / "others.txt").write_text("P071 slept well\n", "utf-16")
    found = plan(GONE, [tmp_path])
    assert [(each.path.name, each.action) for each in found.steps] == [("notes.txt", Action.LOOK)]
    assert not carry_out(found).is_clean


def test_data_is_looked_for_also_if_each_sample_is_a_chunk(tmp_path: Path) -> None:
    values = ecg_values(60, 7)
    stamps = BEGIN_S + np.arange(60) / 130
    header, _, samples = ours(1, "polar_h10", "ecg", values[:1], stamps[:1], GONE).partition(b"!")
    single = b"".join(
        made.samples(1, "float32", [row], [stamp])
        for row, stamp in zip(values.tolist(), stamps.tolist(), strict=True)
    )
    (tmp_path / "rec.xdf").write_bytes(made.xdf(header + samples, single))
    (tmp_path / "copy.dat").write_bytes(values[1:].tobytes())
    report = carry_out(plan(GONE, [tmp_path]))
    assert [each.path.name for each in report.left] == ["copy.dat"]


def test_the_command_shows_the_plan_and_does_nothing_unless_it_is_told(study: Path) -> None:
    def hashes() -> dict[Path, str]:
        return {path: digest(path) for path in study.rglob("*") if path.is_file()}

    before = hashes()
    command, runner = Typer(), CliRunner()
    command.command()(withdraw)
    refused = runner.invoke(command, [GONE, str(study)], input="n\n")
    assert refused.exit_code == 1
    assert "together.xdf" in refused.output.replace("\n", "")
    planned = runner.invoke(command, [GONE, str(study), "--json"])
    assert json.loads(planned.stdout).keys() == {"plan"}
    assert hashes() == before

    (study / f"{GONE}_consent.pdf").unlink()
    report = study.parent / "report.json"
    done = runner.invoke(command, [GONE, str(study), "--yes", "--report", str(report)])
    assert done.exit_code == 0, done.output
    assert json.loads(report.read_text())["report"]["left"] == []
    assert runner.invoke(command, [GONE, str(study)]).exit_code == 0


def test_a_bag_without_metadata_is_left_to_a_person(study: Path) -> None:
    shutil.copytree(study / "together_bag", study / "died")
    (study / "died" / "metadata.yaml").unlink()
    found, report = _withdrawn(study)
    assert any(study / "died" in each.path.parents for each in report.left), found.steps


@pytest.mark.parametrize("until", ["while it writes", "before it renames", "before it deletes"])
def test_a_withdrawal_that_was_killed_is_finished_by_the_next(study: Path, until: str) -> None:
    """In each state in which a program that is killed may leave a bag that it rewrites."""
    (study / f"{GONE}_consent.pdf").unlink()
    bag, whole = study / "together_bag", study / "as before"
    shutil.copytree(bag, whole)
    assert carry_out(plan(GONE, [bag])).is_clean
    done = {each.name: digest(each) for each in bag.iterdir()}
    old, new = study / ".together_bag.old", study / ".together_bag.without"
    if until == "while it writes":
        (study / ".together_bag.without.made" / "together_bag").mkdir(parents=True)
        (study / ".together_bag.without.made" / "together_bag" / "a.mcap").write_bytes(b"half")
        shutil.rmtree(bag)
        whole.rename(bag)
    elif until == "before it renames":
        bag.rename(new)
        whole.rename(old)
    else:
        whole.rename(old)
    (study / ".together.xdf.without").write_bytes(b"XDF:half")
    found, report = _withdrawn(study)
    assert [each.error for each in report.done if each.error] == []
    assert report.is_clean, report.left
    assert {each.name: digest(each) for each in bag.iterdir()} == done
    assert not [each for each in study.iterdir() if each.name.startswith(".")]
    assert {each.path for each in found.steps if each.action is not Action.LOOK}
    assert carry_out(plan(GONE, [study])).done == ()


def test_what_the_plan_says_is_done_and_nothing_else(study: Path) -> None:
    (study / f"{GONE}_consent.pdf").unlink()

    def hashes() -> dict[Path, str]:
        return {path: digest(path) for path in study.rglob("*") if path.is_file()}

    before = hashes()
    found = plan(GONE, [study])
    assert hashes() == before
    carry_out(found)
    after = hashes()

    def of(action: Action) -> set[Path]:
        paths = [each.path for each in found.steps if each.action is action]
        return {path for path in before if any(path == e or e in path.parents for e in paths)}

    assert {path for path in before if path not in after} == of(Action.DELETE)
    changed = {path for path, told in after.items() if told != before.get(path)}
    # The metadata of a bag need not change.
    assert changed <= of(Action.REWRITE)
    assert {path.name for path in of(Action.REWRITE) - changed} <= {"metadata.yaml"}
