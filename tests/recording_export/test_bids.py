"""A BIDS dataset has every sample of a recording, bit for bit and at its time."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.contents.choice import Wish, choose
from biosensor_gateway.recording.contents.opening import open_contents
from biosensor_gateway.recording.export.bids.dataset import BidsDataset
from biosensor_gateway.recording.export.bids.file_names import labels
from biosensor_gateway.recording.export.exporter import Clock, Order
from biosensor_gateway.recording.export.exporting import Task, export
from biosensor_gateway.recording.participants import entities_of
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.settings.names import label
from tests.recording_export.bids_shapes import (
    SHAPES,
    h10,
    marker,
    numbers,
    ours,
    stream,
    times,
)
from tests.recording_export.bids_tables import find, read
from tests.recording_export.conftest import Exporting
from tests.xdf import xdf_file as made


def _dataset(exported: Exporting, content: bytes, **wish: str) -> Path:
    return exported(content, "bids", wish=Wish(**wish)).written[0].path  # type: ignore[arg-type]


def _float32(texts: list[str]) -> np.ndarray:
    return np.array([np.float32("nan" if text == "n/a" else text) for text in texts])


def _folders(dataset: Path) -> list[str]:
    return sorted(each.name for each in dataset.iterdir() if each.is_dir())


def test_a_signal_is_the_same_bit_for_bit_and_gaps_are_empty_rows(exported: Exporting) -> None:
    table = read(_dataset(exported, SHAPES["one person"]), "recording-polarh10ecg_physio")
    assert table.sidecar["Columns"] == ["timestamp", "ECG"]
    assert table.sidecar["SamplingFrequency"] == pytest.approx(130.0, rel=1e-9)
    assert table.sidecar["SamplingFrequencyNominal"] == 130.0
    assert (table.sidecar["EmptyRows"], table.sidecar["Gaps"]) == (40, 1)
    assert table.sidecar["ECG"]["Units"] == "uV"
    assert table.sidecar["Manufacturer"] == "Acme"
    stamps = table.of("timestamp")
    assert [number for number, text in enumerate(stamps) if text == "n/a"] == list(range(300, 340))
    assert all(row["ECG"] == "n/a" for row in table.rows[300:340])
    present = [row for row in table.rows if row["timestamp"] != "n/a"]
    values = _float32([row["ECG"] for row in present])
    assert values.tobytes() == numbers(960).ravel().tobytes()
    at = [float(row["timestamp"]) for row in present]
    assert at == pytest.approx(np.delete(times(1000, 130.0), slice(300, 340)) - 100.0, abs=1e-6)


def test_numbers_are_as_short_as_they_can_be(exported: Exporting) -> None:
    values = np.array([[0.1], [-2.5], [1e-7], [3e10], [0.0]], np.float32)
    content = made.xdf(stream(1, "a", values, times(5, 4.0), rate=4.0))
    table = read(_dataset(exported, content), "recording-a_physio")
    assert table.of("Test") == ["0.1", "-2.5", "1e-7", "30000000000.0", "0.0"]


def test_motion_has_its_own_folder_and_channels(exported: Exporting) -> None:
    dataset = _dataset(exported, SHAPES["one person"])
    table = read(dataset, "tracksys-polarh10acc_motion")
    found = np.column_stack([_float32(table.of(axis)) for axis in "XYZ"])
    assert found.tobytes() == numbers(300, 3).tobytes()
    assert table.sidecar["ACCELChannelCount"] == 3
    assert table.sidecar["SamplingFrequencyEffective"] == pytest.approx(50.0)
    channels = find(dataset, "*_channels.tsv").read_text().splitlines()
    assert channels[0].split("\t") == ["name", "component", "type", "tracked_point", "units"]
    assert channels[1:] == [
        "timestamp\tn/a\tLATENCY\tn/a\ts",
        *(f"{axis}\t{axis.lower()}\tACCEL\tpolar_h10\tg" for axis in "XYZ"),
    ]


def test_beats_are_a_table_of_moments(exported: Exporting) -> None:
    table = read(
        _dataset(exported, SHAPES["irregular only"]), "recording-bleheartrateibi_physioevents"
    )
    assert table.sidecar["Columns"] == ["onset", "duration", "RR"]
    assert _float32(table.of("RR")).tobytes() == numbers(9).ravel().tobytes()
    assert list(map(float, table.of("onset"))) == pytest.approx(np.arange(9) / 1.1, abs=1e-6)


def test_markers_are_events_and_what_was_taken_back_says_so(exported: Exporting) -> None:
    table = read(_dataset(exported, SHAPES["one person"]), "_events")
    assert table.of("trial_type") == ["baseline", "stimulus on", "note", "undo"]
    assert table.of("undone") == ["no", "yes", "no", "no"]
    assert table.of("onset") == ["1.000000", "2.000000", "3.000000", "4.000000"]
    assert json.loads(table.of("value")[2])["note"] == "Übelkeit?"


def test_markers_of_other_programs_are_events_too(exported: Exporting) -> None:
    table = read(_dataset(exported, SHAPES["foreign"]) / "sub-unknown" / "beh", "_events")
    names = dict(zip(table.of("trial_type"), table.of("stream"), strict=True))
    assert names["trial 3, left"] == "PsychoPy"
    assert names["4"] == "keys"
    assert list(map(float, table.of("onset"))) == sorted(map(float, table.of("onset")))


def test_a_marker_is_when_it_says_it_was(exported: Exporting) -> None:
    agent = DeviceIdentity("gateway", "lab-pc")
    texts = [marker(1, "later", 105.0), marker(2, "earlier", 103.5), marker(3, "wrong", 9e9)]
    of_agent = ours(2, agent, "markers", texts, [105.0, 105.0, 106.0], fmt="string", kind="Markers")
    content = made.xdf(h10(10, "p1"), of_agent + made.offsets(2, (100.0, 105.0, 110.0), 7.0))
    # Beside the offsets of 0 of its own, so half way.
    table = read(_dataset(exported, content), "_events")
    onsets = dict(zip(table.of("trial_type"), map(float, table.of("onset")), strict=True))
    assert list(onsets) == ["earlier", "later", "wrong"]
    assert onsets["later"] - onsets["earlier"] == pytest.approx(1.5, abs=1e-6)


def test_what_happened_to_a_device_is_with_its_wearer(exported: Exporting) -> None:
    agent = DeviceIdentity("gateway", "lab-pc")
    events = [
        {"event": "heartbeat"},
        {"event": "off_body", "participant": "p2"},
        {"event": "connected", "participant": "p1"},
        {"event": "agent_started"},
    ]
    texts = [[json.dumps(each)] for each in events]
    told = ours(9, agent, "events", texts, times(4, 1.0), fmt="string", kind="Markers")
    counters = ours(10, agent, "counters", [["{}"]], [100.0], fmt="string", kind="Counters")
    content = made.xdf(h10(1, "p1"), h10(4, "p2"), told, counters)
    dataset = _dataset(exported, content)
    assert read(dataset, "sub-p1_task-study_events").of("trial_type") == ["connected"]
    assert read(dataset, "sub-p2_task-study_events").of("trial_type") == ["off_body"]


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ("one person", ["sub-p01"]),
        ("two persons", ["sub-p01", "sub-p02"]),
        ("two persons and a room", ["sub-p01", "sub-p02", "sub-shared"]),
        ("nobody", ["sub-unknown"]),
        ("two sensors of a kind", ["sub-p01"]),
    ],
)
def test_everybody_has_a_folder(shape: str, expected: list[str], exported: Exporting) -> None:
    dataset = _dataset(exported, SHAPES[shape])
    assert _folders(dataset) == expected
    rows = (dataset / "participants.tsv").read_text("utf-8").splitlines()
    assert sorted(row.split("\t")[0] for row in rows[1:]) == expected


def test_names_in_any_script_stay_apart(exported: Exporting) -> None:
    dataset = _dataset(exported, SHAPES["unicode"])
    rows = [
        row.split("\t") for row in (dataset / "participants.tsv").read_text("utf-8").splitlines()
    ]
    assert {row[1] for row in rows[1:]} == {"Jörg", "Jorg", "李", "王"}
    assert len(_folders(dataset)) == 4


def test_two_sensors_of_a_kind_have_two_tables(exported: Exporting) -> None:
    dataset = _dataset(exported, SHAPES["two sensors of a kind"])
    names = {path.name for path in dataset.rglob("*ecg*_physio.tsv.gz")}
    recordings = {name.split("recording-")[1].split("_")[0] for name in names}
    assert recordings == {"polarh10ecgA1", "polarh10leftecg", "polarh10ecgA3", "polarh10ecgA4"}


def test_one_person_alone_can_be_cut_out(exported: Exporting) -> None:
    dataset = _dataset(exported, SHAPES["two persons"], participant="p02")
    assert _folders(dataset) == ["sub-p02"]


def test_who_is_left_out_leaves_nothing_to_the_other(exported: Exporting) -> None:
    dataset = _dataset(exported, SHAPES["two persons and a room"], without="p01")
    assert _folders(dataset) == ["sub-p02", "sub-shared"]
    assert "p01" not in "".join(map(str, dataset.rglob("*")))
    read(dataset / "sub-shared", "recording-room_physio")


def test_time_has_one_zero_for_all(exported: Exporting) -> None:
    dataset = _dataset(exported, SHAPES["two persons and a room"], begin="2")
    for path in dataset.rglob("*beh/*.json"):
        assert json.loads(path.read_text("utf-8"))["TimeZero"]["LslTime"] == 102.0
    assert read(dataset, "recording-room_physio").sidecar["StartTime"] == 0.0


def test_stamps_that_jitter_cost_no_sample(exported: Exporting) -> None:
    content = SHAPES["foreign"].replace(b"<type>EEG</type>", b"<type>MEG</type>")
    outcome = exported(content, "bids")
    (written,) = outcome.written
    table = read(written.path, "recording-BrainAmp01_physio")
    sidecar = table.sidecar
    present = [row for row in table.rows if row["timestamp"] != "n/a"]
    columns = sidecar["Columns"][1:]
    found = np.column_stack([_float32([row[name] for row in present]) for name in columns])
    assert found.tobytes() == numbers(2000, 4).tobytes()
    assert sidecar["SamplesInAnotherRow"] > 0
    assert len(table.rows) == sidecar["Samples"] + sidecar["EmptyRows"]
    rows = [number for number, row in enumerate(table.rows) if row["timestamp"] != "n/a"]
    at = sidecar["StartTime"] + np.array(rows) / sidecar["SamplingFrequency"]
    away = np.abs(at - [float(row["timestamp"]) for row in present]).max()
    assert away == pytest.approx(sidecar["LargestDisplacement"], abs=2e-6)
    assert any("BrainAmp" in note and "row" in note for note in written.notes)
    assert any("empty" in note for note in written.notes)


def test_what_is_far_apart_has_tables_of_its_own(exported: Exporting) -> None:
    outcome = exported(SHAPES["far apart"], "bids")
    (written,) = outcome.written
    starts = [
        read(written.path, f"recording-{name}_physio").sidecar["StartTime"]
        for name in ("paused+part1", "paused+part2", "setback+part1", "setback+part2")
    ]
    assert starts == pytest.approx([0.0, 7300.0, 50.0, 20.0], abs=1e-5)
    assert not list(written.path.rglob("*nowhere*"))
    assert any("nowhere" in note for note in written.notes)
    assert any("paused, set back" in note for note in written.notes)


def test_unix_time_is_counted_from_the_same_zero(tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    header = b"<?xml version='1.0'?><info><datetime>2026-03-14T10:30:00+0100</datetime></info>"
    signal = stream(1, "a", numbers(8), times(8, 4.0), rate=4.0)
    path.write_bytes(b"XDF:" + made.chunk(1, header) + signal)
    with open_contents(path) as contents:
        chosen = choose(contents, Wish())
        BidsDataset().write(chosen, Order(Clock.WALL, "study"), tmp_path / "out", lambda _: None)
    table = read(tmp_path / "out", "recording-a_physio")
    assert table.sidecar["TimeZero"]["Date"] == "2026-03-14T09:30:00.000000+00:00"
    assert table.of("timestamp") == [str(n / 4) for n in range(8)]


@pytest.mark.parametrize(
    ("name", "order", "expected"),
    [
        ("study", {}, "sub-p7_task-study_"),
        ("sub-x9_ses-S1_task-walk_run-002_beh", {}, "sub-p7_ses-S1_task-walk_run-002_"),
        ("a", {"task": "Gehweg", "session": "2"}, "sub-p7_ses-2_task-Gehweg_"),
    ],
)
def test_a_name_in_the_manner_of_bids_is_kept(
    name: str, order: dict[str, str], expected: str, tmp_path: Path
) -> None:
    path = tmp_path / "some.xdf"
    path.write_bytes(SHAPES["irregular only"])
    with open_contents(path) as contents:
        chosen = choose(contents, Wish())
        wanted = replace(Order(Clock.LSL, name), **order)
        BidsDataset().write(chosen, wanted, tmp_path / "out", lambda _: None)
    assert find(tmp_path / "out", "*_physioevents.json").name.startswith(expected)


def test_a_task_that_is_no_label_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "some.xdf"
    path.write_bytes(SHAPES["irregular only"])
    task = Task(["bids"], Wish(), task="go away")
    with pytest.raises(ConfigError, match="'go away' cannot be the task") as caught:
        export(path, task, lambda _name, _s: lambda _done: None)
    assert caught.value.reason is ConfigReason.WRONG_VALUE
    assert [each.name for each in tmp_path.iterdir()] == ["some.xdf"]


def test_nothing_for_bids_is_no_dataset(exported: Exporting) -> None:
    agent = DeviceIdentity("gateway", "lab-pc")
    content = made.xdf(ours(1, agent, "counters", [["{}"]], [100.0], fmt="string"))
    with pytest.raises(RecordingError) as caught:
        exported(content, "bids")
    assert caught.value.reason is RecordingReason.EMPTY


def test_what_is_damaged_costs_only_itself(exported: Exporting) -> None:
    whole = SHAPES["one person"]
    content = whole[:9000] + b"\xff" * 30 + whole[9030 : len(whole) - 700]
    outcome = exported(content, "bids")
    assert outcome.damages
    table = read(outcome.written[0].path, "recording-polarh10ecg_physio")
    assert 800 < table.sidecar["Samples"] < 960


def test_a_label_is_letters_and_digits_and_nobody_elses() -> None:
    assert label("P-01 (left)") == "P01left"
    assert label("Jörg") == "Jorg"
    assert label("李") != label("王")
    assert len(label("x" * 500)) == 40
    found = labels({1: ["a"], 2: ["A"], 3: ["a", "x"], 4: [""]})
    assert len({each.lower() for each in found.values()}) == 4


def test_only_names_in_the_manner_of_bids_say_something() -> None:
    assert entities_of("my_study-2") == {}
    assert entities_of("sub-1_run-x_task-a") == {"sub": "1", "task": "a"}
