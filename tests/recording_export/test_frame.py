"""What holds for every format: names, refusals, damages, participants, the README of an export."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import stat
import sys
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from biosensor_common.errors import ConfigError, ConfigReason, GatewayError
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.cli import xdf as command
from biosensor_gateway.recording.contents.choice import Chosen, Selection
from biosensor_gateway.recording.export import job
from biosensor_gateway.recording.export.csv import wide
from biosensor_gateway.recording.export.exporter import (
    FORMATS,
    Clock,
    ExportOptions,
    Progress,
    Times,
)
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.export.outcome import Outcome, Written, outcome_json, sentences
from biosensor_gateway.recording.participants import Whose
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from tests.recording_export.bids_shapes import (
    BEGIN_S,
    SHAPES,
    h10,
    numbers,
    ours,
    read,
    stream,
    times,
)
from tests.recording_export.conftest import Exporting
from tests.recording_export.study import study
from tests.xdf import xdf_file as made

# What holds for every format: names, refusals, damages, what is left behind.

WHOLE = b"".join(made.two_streams())


class _Failing:
    """A format that fails on the way."""

    suffix = "_failing"

    def __init__(self, error: BaseException) -> None:
        self._error = error

    def write(
        self, chosen: Chosen, options: ExportOptions, target: Path, progress: Progress
    ) -> Sequence[str]:
        target.mkdir()
        (target / "half").write_text("half")
        raise self._error


def _names(folder: Path) -> list[str]:
    return sorted(each.name for each in folder.iterdir())


@pytest.mark.parametrize("name", ["csv", "csv.gz", "csv-long", "csv-long.gz"])
def test_a_format_is_written_beside_the_recording(
    name: str, exported: Exporting, tmp_path: Path
) -> None:
    outcome = exported(WHOLE, name)
    (written,) = outcome.written
    suffix = {"csv": "_csv", "csv.gz": "_csv"}.get(name, name.replace("csv-long", ".csv"))
    assert written.path == tmp_path / f"study{suffix}"
    told = [f"study{suffix}.README.txt"] if "long" in name else []
    assert _names(tmp_path) == sorted(["study.xdf", f"study{suffix}", *told])
    assert written.size > 0
    assert outcome.damages == ()


def test_a_format_without_anything_for_it_keeps_no_other_from_being_written(
    exported: Exporting, tmp_path: Path
) -> None:
    outcome = exported(WHOLE, "csv", "kubios", "edf")
    assert [each.format for each in outcome.written] == ["csv", "edf"]
    ((name, why),) = [(each.format, each.why) for each in outcome.without]
    assert name == "kubios"
    assert "nothing was written for Kubios" in why
    assert _names(tmp_path) == sorted(["study.xdf", "study_csv", "study_edf"])


def test_several_formats_go_into_a_folder(exported: Exporting, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    outcome = exported(WHOLE, "csv", "csv-long", output=tmp_path / "out")
    assert _names(tmp_path / "out") == ["study.csv", "study.csv.README.txt", "study_csv"]
    assert [each.format for each in outcome.written] == ["csv", "csv-long"]


@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_nothing_is_overwritten(kind: str, exported: Exporting, tmp_path: Path) -> None:
    target = tmp_path / "study.csv"
    if kind == "file":
        target.write_text("precious")
    elif kind == "folder":
        target.mkdir()
    else:
        target.symlink_to(tmp_path / "nowhere")
    with pytest.raises(ConfigError, match="exists and is not overwritten") as caught:
        exported(WHOLE, "csv", "csv-long")
    assert caught.value.reason is ConfigReason.EXISTS
    assert _names(tmp_path) == ["study.csv", "study.xdf"]
    assert kind != "file" or target.read_text() == "precious"


@pytest.mark.parametrize(
    ("formats", "output", "words"),
    [
        (("csv-long",), "table.txt", "ends in .csv"),
        (("csv", "csv-long"), "none", "there is no folder"),
        (("csv", "csv.gz"), None, "would have the same name"),
    ],
)
def test_a_wrong_place_is_one_sentence(
    formats: Sequence[str], output: str | None, words: str, exported: Exporting, tmp_path: Path
) -> None:
    place = None if output is None else tmp_path / output
    with pytest.raises(ConfigError, match=re.escape(words)):
        exported(WHOLE, *formats, output=place)
    assert _names(tmp_path) == ["study.xdf"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_what_fails_on_the_way_leaves_nothing(
    error: BaseException, exported: Exporting, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    formats = {**FORMATS, "failing": lambda: _Failing(error)}
    monkeypatch.setattr(job, "FORMATS", formats)
    with pytest.raises((RecordingError, KeyboardInterrupt)) as caught:
        exported(WHOLE, "csv-long", "failing")
    if isinstance(caught.value, RecordingError):
        assert caught.value.reason is RecordingReason.UNWRITABLE
        assert "study_failing: No space left on device; free some space" in str(caught.value)
    assert _names(tmp_path) == ["study.csv", "study.csv.README.txt", "study.xdf"]


def _nearly_full(_folder: Path) -> SimpleNamespace:
    return SimpleNamespace(free=1000)


def test_a_disk_that_is_nearly_full_is_left_alone(
    exported: Exporting, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", _nearly_full)
    with pytest.raises(RecordingError, match="free some space") as caught:
        exported(WHOLE, "csv")
    assert caught.value.reason is RecordingReason.UNWRITABLE
    assert _names(tmp_path) == ["study.xdf"]


def test_what_is_not_in_it_is_not_written(exported: Exporting, tmp_path: Path) -> None:
    with pytest.raises(RecordingError) as caught:
        exported(WHOLE, "csv", selection=Selection(begin="9:00:00"))
    assert caught.value.reason is RecordingReason.EMPTY
    with pytest.raises(ConfigError, match="time of day"):
        exported(WHOLE, "csv", clock=Clock.WALL)
    assert _names(tmp_path) == ["study.xdf"]


def test_a_damaged_recording_is_exported_and_said(exported: Exporting) -> None:
    begin = made.chunk_ends(WHOLE)[20]
    outcome = exported(WHOLE[:begin] + b"\xff" * 20 + WHOLE[begin + 20 : -300], "csv")
    assert len(outcome.damages) == 2
    assert (outcome.written[0].path / "numbers.csv").stat().st_size > 1000


@pytest.mark.parametrize("length", [5, 60, 400])
def test_a_recording_without_a_sample_is_one_sentence(length: int, exported: Exporting) -> None:
    with pytest.raises(GatewayError) as caught:
        exported(WHOLE[:length], "csv")
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows knows no such modes")
def test_who_may_not_read_the_recording_may_not_read_the_tables(
    exported: Exporting, tmp_path: Path
) -> None:
    (tmp_path / "study.xdf").touch(0o600)
    mask = os.umask(0)
    try:
        outcome = exported(WHOLE, "csv", "csv-long")
    finally:
        os.umask(mask)
    files = [outcome.written[0].path / "numbers.csv", outcome.written[1].path]
    assert [stat.S_IMODE(each.stat().st_mode) for each in files] == [0o600, 0o600]


# An export says whose data it writes where the recording's name and its sensors differ.
def exported(folder: Path, content: bytes, participant: str, *formats: str,
             selection: Selection = Selection(),  # noqa: B008 - it cannot be changed
             whose: Whose | None = None) -> Outcome:  # fmt: skip
    path = folder / f"sub-{participant}_ses-S001_task-walk_run-001_beh.xdf"
    path.write_bytes(content)
    task = Task(formats or ("bids",), selection, whose=whose)
    return export(path, task, lambda _name, _s: lambda _done: None)


def people(outcome: Outcome) -> list[str]:
    return sorted(each.name for each in outcome.written[0].path.glob("sub-*"))


def test_the_sensors_are_believed_and_the_other_name_is_said(tmp_path: Path) -> None:
    outcome = exported(tmp_path, SHAPES["two persons"], "P03")
    assert people(outcome) == ["sub-p01", "sub-p02"]
    assert (outcome.is_whole, outcome.is_certain) == (True, False)
    said = "\n".join(sentences(outcome))
    assert "the file is called P03, but its sensors are worn by p01 and p02" in said
    assert "--whose sensors" in said
    assert json.loads(outcome_json(outcome))["mismatch"]["others"] == ["p01", "p02"]


def test_whoever_says_that_the_sensors_are_right_is_believed(tmp_path: Path) -> None:
    outcome = exported(tmp_path, SHAPES["two persons"], "P03", whose=Whose.SENSORS)
    assert people(outcome) == ["sub-p01", "sub-p02"]
    assert outcome.is_certain


def test_the_name_may_be_right(tmp_path: Path) -> None:
    agent = DeviceIdentity("gateway", "lab-pc")
    texts = [[json.dumps({"event": "off_body", "participant": "p1"})]]
    events = ours(9, agent, "events", texts, times(1, 1.0), fmt="string", kind="Markers")
    content = made.xdf(h10(1, "p1"), events)
    outcome = exported(tmp_path, content, "P03", "bids", "csv-long", whose=Whose.NAME)
    assert people(outcome) == ["sub-P03"]
    assert outcome.is_certain
    dataset, table = (each.path for each in outcome.written)
    assert read(dataset, "sub-P03_ses-S001_task-walk_run-001_events").of("trial_type") == [
        "off_body"
    ]
    assert '"P03"' in table.read_text()
    assert '"p1",' not in table.read_text()


@pytest.mark.parametrize("participant", ["p01", "P01", "group1"])
def test_what_agrees_is_not_spoken_of(participant: str, tmp_path: Path) -> None:
    shape = "two persons" if participant.startswith("group") else "one person"
    assert exported(tmp_path, SHAPES[shape], participant).is_certain


def test_only_what_is_written_counts(tmp_path: Path) -> None:
    selection = Selection(participant="p01")
    assert exported(tmp_path, SHAPES["two persons"], "p01", selection=selection).is_certain


# README.txt says what an export holds: files, people, units, and what is amiss.
FOLDERS = ("csv", "csv.gz", "edf", "kubios", "ledalab", "mcap")


@pytest.mark.parametrize("name", FOLDERS)
def test_each_file_or_topic_is_named_with_what_it_is(name: str, exported: Exporting) -> None:
    (written,) = exported(study(), name).written
    text = (written.path / "README.txt").read_text("utf-8")
    listed = text.partition("HOW TO READ IT")[0]
    if name == "mcap":
        assert "/P1/biosensors/polar_h10/ecg_stamped" in listed
    else:
        data = [each.name for each in written.path.iterdir() if each.name.startswith("P")]
        assert data
        assert [each for each in data if each not in listed] == []
    person = "P2" if name == "ledalab" else "P1"
    assert f"of {person}, measured by" in " ".join(listed.split())


@pytest.mark.parametrize("name", FOLDERS)
def test_all_that_is_said_of_the_export_is_in_it(name: str, exported: Exporting) -> None:
    (written,) = exported(study(), name, times=Times.EVEN).written
    text = " ".join((written.path / "README.txt").read_text("utf-8").split())
    for note in written.notes:
        assert " ".join(note.split()) in text


def test_the_begin_is_told_on_the_clock_of_the_times(exported: Exporting) -> None:
    (written,) = exported(study(), "csv", clock=Clock.WALL).written
    text = (written.path / "README.txt").read_text("utf-8")
    assert "starts at 1790000000.250000, which is 2026-09-21T14:13:20.250000+00:00" in text


# A table for each rate: every sample once, in the row of its time, beside what happened.

RATE = 100.0


def _export(tmp_path: Path, *streams: bytes, name: str = "csv") -> Written:
    path = tmp_path / "study.xdf"
    path.write_bytes(made.xdf(*streams))
    task = Task([name], Selection(), is_wide=True)
    (written,) = job.export(path, task, lambda _name, _s: lambda _done: None).written
    return written


def _table(written: Written, name: str = "all_100Hz.csv") -> list[dict[str, str]]:
    with (written.path / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _column(rows: Sequence[dict[str, str]], name: str) -> NDArray[np.float64]:
    return np.array([float(row[name]) for row in rows])


def test_a_stream_whose_header_names_no_rate_is_in_the_table_of_its_rate(tmp_path: Path) -> None:
    stamps = [1000.0 + each / 100 for each in range(400)]
    header = made.stream_header(1, "a", kind="EEG", rate=0.0)
    samples = made.samples(1, "float32", [[float(each)] for each in range(400)], stamps)
    written = _export(tmp_path, header, samples)
    assert [float(row["a.1"]) for row in _table(written)] == [float(each) for each in range(400)]
    assert any("names no rate; it is treated as 100 Hz" in note for note in written.notes)


@pytest.mark.parametrize("block", [7, 64, 4096])
def test_every_sample_stands_once_in_the_row_of_its_time(
    block: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wide, "_BLOCK", block)
    first, second = numbers(2000, 2), numbers(1500, 1, seed=1)
    late = times(1500, 99.9, BEGIN_S + 3.004)
    gap = times(2000, RATE)
    gap[800:] += 40.0
    written = _export(
        tmp_path,
        stream(1, "a", first, gap, rate=RATE),
        stream(2, "b", second, late, rate=RATE),
        stream(3, "slow", numbers(50), times(50, 4.0), rate=4.0),
        stream(4, "beats", numbers(9), times(9, 1.0)),
    )
    rows = _table(written)
    since = _column(rows, "seconds")
    assert (np.diff(since) > 0).all()
    for name, values, stamps in (
        ("a.1", first[:, 0], gap),
        ("a.2", first[:, 1], gap),
        ("b.1", second[:, 0], late),
    ):
        found = _column(rows, name)
        has_value = ~np.isnan(values)
        at = np.searchsorted(since, stamps[has_value] - BEGIN_S)
        near = np.where(
            np.abs(since[np.minimum(at, len(since) - 1)] - (stamps[has_value] - BEGIN_S))
            <= np.abs(since[at - 1] - (stamps[has_value] - BEGIN_S)),
            np.minimum(at, len(since) - 1),
            at - 1,
        )
        assert found[near].astype(np.float32).tolist() == values[has_value].tolist()
        assert np.count_nonzero(~np.isnan(found)) == np.count_nonzero(has_value)
    # Where nothing was measured stands no row.
    assert not ((since > 20.0) & (since < 47.9)).any()
    assert (written.path / "all_4Hz.csv").exists()
    (note,) = (each for each in written.notes if each.startswith("all_100Hz.csv"))
    assert 4.0 < float(note.split("at most ")[1].split(" ms")[0]) <= 5.01


def test_a_marker_is_at_the_row_of_its_time_or_the_next_one(tmp_path: Path) -> None:
    stamps = times(400, RATE)
    stamps[200:] += 5.0
    told, moments = [["go"], ["in the gap"], ["after"]], [1.0, 4.0, 20.0]
    written = _export(
        tmp_path,
        stream(1, "a", numbers(400), stamps, rate=RATE),
        stream(2, "m", told, [BEGIN_S + each for each in moments], fmt="string", kind="Markers"),
    )
    rows = {row["marker"]: float(row["seconds"]) for row in _table(written) if row["marker"]}
    assert rows == {"go": pytest.approx(1.0), "in the gap": pytest.approx(7.0)}
    assert any("1 marker" in note and "all_markers.csv" in note for note in written.notes)


def test_a_stream_whose_time_steps_back_is_in_no_wide_table_and_that_is_said(
    tmp_path: Path,
) -> None:
    stamps = times(400, RATE)
    stamps[200:] -= 60.0
    written = _export(
        tmp_path,
        stream(1, "a", numbers(400), times(400, RATE), rate=RATE),
        stream(2, "b", numbers(400), stamps, rate=RATE),
    )
    assert not any(name.startswith("b") for name in _table(written)[0])
    assert not written.is_whole
    assert any(note.startswith("b: in no wide table") for note in written.notes)


def test_a_stream_of_the_name_of_a_table_has_another_file(tmp_path: Path) -> None:
    written = _export(tmp_path, stream(1, "all_100Hz", numbers(10), times(10, RATE), rate=RATE))
    assert {each.name for each in written.path.iterdir()} >= {"all_100Hz.csv", "all_100Hz_2.csv"}


def test_the_command_writes_the_table_that_it_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    path.write_bytes(made.xdf(stream(1, "a", numbers(200), times(200, RATE), rate=RATE)))
    outcome = CliRunner().invoke(command.app, ["export", str(path), "--to", "csv", "--wide"])
    assert outcome.exit_code == 0, outcome.output
    assert (tmp_path / "study_csv" / "all_100Hz.csv").exists()
