"""BIDS datasets: every sample bit for bit, by kind of signal, study by study."""

from __future__ import annotations

import csv
import gzip
import hashlib
import json
import struct
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from edfio import read_bdf
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.naming import label
from biosensor_common.quantities import ChannelFormat
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.contents.choice import Selection, choose
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.export.bids.dataset import BidsDataset
from biosensor_gateway.recording.export.bids.file_names import labels
from biosensor_gateway.recording.export.bids.study import ADDED, Study
from biosensor_gateway.recording.export.exporter import Clock, ExportOptions
from biosensor_gateway.recording.export.grid import place
from biosensor_gateway.recording.export.job import Task, export, recordings_in
from biosensor_gateway.recording.export.outcome import Outcome, Written
from biosensor_gateway.recording.export.time_axis import find_timing
from biosensor_gateway.recording.participants import Whose, entities_of
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.header import RecordedHeader
from tests.recording_export.bids_shapes import (
    BEGIN_S,
    EEG_VALUES,
    EMG_VALUES,
    GAZE_VALUES,
    SHAPES,
    eeg,
    find,
    h10,
    marker,
    muscles_and_eyes,
    numbers,
    ours,
    read,
    stream,
    times,
)
from tests.recording_export.conftest import Exporting
from tests.rigs.open_elsewhere import SENTENCE, hold_open
from tests.xdf import xdf_file as made

# A BIDS dataset has every sample of a recording, bit for bit and at its time.


def _dataset(exported: Exporting, content: bytes, **selection: str) -> Path:
    return exported(content, "bids", selection=Selection(**selection)).written[0].path  # type: ignore[arg-type]


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
    # Rows are those of the line through the earliest stamps, where each sample has its own.
    assert sidecar["SamplesInAnotherRow"] == 0
    assert len(table.rows) == sidecar["Samples"] + sidecar["EmptyRows"]
    rows = [number for number, row in enumerate(table.rows) if row["timestamp"] != "n/a"]
    at = sidecar["StartTime"] + np.array(rows) / sidecar["SamplingFrequency"]
    away = np.abs(at - [float(row["timestamp"]) for row in present]).max()
    assert away == pytest.approx(sidecar["LargestDisplacement"], abs=2e-6)
    assert any("BrainAmp" in note and "even times" in note for note in written.notes)
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
        chosen = choose(contents, Selection())
        BidsDataset().write(
            chosen, ExportOptions(Clock.WALL, "study"), tmp_path / "out", lambda _: None
        )
    table = read(tmp_path / "out", "recording-a_physio")
    assert table.sidecar["TimeZero"]["Date"] == "2026-03-14T09:30:00.000000+00:00"
    assert table.of("timestamp") == [str(n / 4) for n in range(8)]


@pytest.mark.parametrize(
    ("name", "options", "expected"),
    [
        ("study", {}, "sub-p7_task-study_"),
        ("sub-x9_ses-S1_task-walk_run-002_beh", {}, "sub-p7_ses-S1_task-walk_run-002_"),
        ("a", {"task": "Gehweg", "session": "2"}, "sub-p7_ses-2_task-Gehweg_"),
    ],
)
def test_a_name_in_the_manner_of_bids_is_kept(
    name: str, options: dict[str, str], expected: str, tmp_path: Path
) -> None:
    path = tmp_path / "some.xdf"
    path.write_bytes(SHAPES["irregular only"])
    with open_contents(path) as contents:
        chosen = choose(contents, Selection())
        wanted = replace(ExportOptions(Clock.LSL, name), **options)
        BidsDataset().write(chosen, wanted, tmp_path / "out", lambda _: None)
    assert find(tmp_path / "out", "*_physioevents.json").name.startswith(expected)


def test_a_task_that_is_no_label_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "some.xdf"
    path.write_bytes(SHAPES["irregular only"])
    task = Task(["bids"], Selection(), task="go away")
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


# EEG in a BIDS dataset: every bit, gaps as events and runs, every marker in one of the runs.
def _folder(exported: Exporting, content: bytes) -> Path:
    (written,) = exported(content, "bids").written
    return written.path / "sub-unknown" / "eeg"


def _samples(path: Path) -> np.ndarray:
    header = path.with_suffix(".vhdr").read_text("utf-8")
    kind = np.dtype("<i2" if "BinaryFormat=INT_16" in header else "<f4")
    return np.frombuffer(path.read_bytes(), kind).reshape(-1, 2)


def test_samples_are_the_recorded_ones_and_gaps_are_events_or_runs(exported: Exporting) -> None:
    folder = _folder(exported, eeg())
    first, second = sorted(folder.glob("*_eeg.eeg"))
    assert ("run-01_" in first.name, "run-02_" in second.name) == (True, True)
    rows = _samples(first)
    assert rows[:2000].tobytes() == EEG_VALUES[:2000].tobytes()
    assert np.isnan(rows[2000:2500]).all()
    assert rows[2500:].tobytes() == EEG_VALUES[2000:4000].tobytes()
    assert _samples(second).tobytes() == EEG_VALUES[4000:].tobytes()
    sidecar = json.loads(next(folder.glob("*run-01_eeg.json")).read_text())
    assert sidecar["SamplingFrequency"] == pytest.approx(250.0)
    assert (sidecar["RecordingType"], sidecar["EEGChannelCount"]) == ("discontinuous", 2)


def test_every_marker_is_in_one_run(exported: Exporting) -> None:
    folder = _folder(exported, eeg())
    found = [_rows(each) for each in sorted(folder.glob("*_events.tsv"))]
    assert [[row["trial_type"] for row in rows] for rows in found] == [
        ["before", "a", "BAD_gap", "b, c", "between"],
        ["after"],
    ]
    assert [float(row["onset"]) for row in found[0]] == [-5.0, 1.0, 8.0, 9.0, 30.0]
    assert float(found[0][2]["duration"]) == 2.0
    assert float(found[1][0]["onset"]) == pytest.approx(60.0 - 46.0)
    # BrainVision has no place for what came where no sample is.
    markers = next(folder.glob("*run-01_eeg.vmrk")).read_text("utf-8")
    assert "Mk2=Comment,a,251,1,0" in markers
    assert "Comment,BAD_gap,2001,500,0" in markers


def test_integers_stay_integers_until_a_row_has_to_be_empty(exported: Exporting) -> None:
    folder = _folder(exported, eeg("int16"))
    first, second = sorted(folder.glob("*_eeg.eeg"))
    whole = EEG_VALUES.astype(np.int16)
    assert _samples(second).tobytes() == whole[4000:].tobytes()
    rows = _samples(first)
    assert rows.dtype == np.float32
    assert np.delete(rows, slice(2000, 2500), axis=0).astype(np.int16).tolist() == (
        whole[:4000].tolist()
    )


def test_bursts_become_one_run_of_the_real_rate(exported: Exporting) -> None:
    real = BEGIN_S + np.arange(3000) / 249.0
    stamps = np.repeat(real[49::50], 50)
    values = EEG_VALUES[:3000]
    content = made.xdf(stream(1, "burst", values, stamps, rate=250.0, kind="EEG"))
    folder = _folder(exported, content)
    (only,) = folder.glob("*_eeg.eeg")
    assert _samples(only).tobytes() == values.tobytes()
    sidecar = json.loads(only.with_suffix(".json").read_text())
    assert sidecar["SamplingFrequency"] == pytest.approx(249.0, rel=1e-3)


def test_doubles_are_rounded_and_that_is_said(exported: Exporting) -> None:
    values = np.random.default_rng(1).normal(0, 30, (1000, 2))
    stamps = times(1000, 250.0)
    content = made.xdf(stream(1, "amp", values, stamps, rate=250.0, kind="EEG", fmt="double64"))
    (written,) = exported(content, "bids").written
    (only,) = written.path.rglob("*_eeg.eeg")
    assert _samples(only).tobytes() == values.astype(np.float32).tobytes()
    assert any("double64" in note for note in written.notes)


# EMG and gaze in a BIDS dataset: where each is, what its channels are called, what is said.
@pytest.fixture
def written(exported: Exporting) -> Written:
    (found,) = exported(muscles_and_eyes(), "bids").written
    return found


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))


def _gaze(root: Path, recording: str) -> tuple[dict[str, object], np.ndarray]:
    (path,) = root.rglob(f"*_recording-{recording}_physio.json")
    content = json.loads(path.read_text("utf-8"))
    table = gzip.decompress(path.with_suffix(".tsv.gz").read_bytes()).decode()
    rows = [[float(cell) for cell in line.split("\t")] for line in table.splitlines()]
    return content, np.array(rows)


def test_emg_is_a_bdf_file_with_its_gap_as_an_event(written: Written) -> None:
    (path,) = written.path.rglob("emg/*_recording-shimmeremg_emg.bdf")
    signals = read_bdf(path).signals
    step = 2 * float(np.abs(EMG_VALUES).max()) / (1 << 24)
    for column, signal in enumerate(signals):
        data = signal.data
        assert np.abs(data[:3000] - EMG_VALUES[:3000, column]).max() <= 2 * step
        assert np.abs(data[4024:7024] - EMG_VALUES[3000:, column]).max() <= 2 * step
        np.testing.assert_allclose(data[3000:4024], signal.physical_min, atol=2 * step)
    (events,) = written.path.rglob("emg/*_recording-shimmeremg_events.tsv")
    told = {row["trial_type"]: row for row in _rows(events)}
    assert float(told["BAD_gap"]["onset"]) == pytest.approx(3000 / 512, abs=1e-6)
    assert float(told["BAD_gap"]["duration"]) == pytest.approx(2.0)
    assert float(told["go"]["onset"]) == pytest.approx(1.0)
    assert set(told) == {"BAD_gap", "go", "stop"}


def test_channels_and_sidecar_of_emg_agree_with_its_file(written: Written) -> None:
    (path,) = written.path.rglob("emg/*_recording-shimmeremg_channels.tsv")
    rows = _rows(path)
    assert [(row["name"], row["type"], row["units"]) for row in rows] == [
        ("EMG1", "EMG", "mV"),
        ("EMG2", "EMG", "mV"),
    ]
    (sidecar,) = written.path.rglob("emg/*_recording-shimmeremg_emg.json")
    content = json.loads(sidecar.read_text("utf-8"))
    assert (content["EMGChannelCount"], content["RecordingType"]) == (2, "discontinuous")
    assert (content["Samples"], content["EmptyRows"], content["Gaps"]) == (6000, 1024, 1)


def test_emg_of_a_bursty_sender_is_one_run_of_its_rate(written: Written) -> None:
    (path,) = written.path.rglob("emg/*_recording-armband_emg.bdf")
    (first, *_) = read_bdf(path).signals
    assert first.sampling_frequency == pytest.approx(500.0, rel=1e-3)
    assert any("armband: even times" in note for note in written.notes)


def test_a_value_that_is_none_is_an_event_of_emg(exported: Exporting) -> None:
    values = EMG_VALUES.copy()
    values[100:200, 1] = np.nan
    content = made.xdf(stream(1, "arm", values, times(6000, 500.0), rate=500.0, kind="EMG"))
    (found,) = exported(content, "bids").written
    (events,) = found.path.rglob("emg/*_events.tsv")
    (row,) = _rows(events)
    assert (row["trial_type"], row["note"]) == ("BAD_value", "no value: 2")
    assert float(row["onset"]) == pytest.approx(0.2, abs=1e-3)
    assert float(row["duration"]) == pytest.approx(0.2, abs=1e-3)


def test_each_eye_has_a_table_with_x_and_y_first(written: Written) -> None:
    left, rows = _gaze(written.path, "trackereye1")
    assert left["PhysioType"] == "eyetrack"
    assert left["RecordedEye"] == "left"
    assert left["Columns"] == [
        "timestamp",
        "x_coordinate",
        "y_coordinate",
        "pupil_size",
        "confidence",
    ]
    assert rows[:, 1:].astype(np.float32).tolist() == GAZE_VALUES[:, [0, 1, 2, 6]].tolist()
    right, rows = _gaze(written.path, "trackereye2")
    assert (right["RecordedEye"], left["x_coordinate"]) == (
        "right",
        {"Units": "px", "Description": "left_gaze_x of tracker"},
    )
    assert rows[:, 1:].astype(np.float32).tolist() == GAZE_VALUES[:, [3, 4, 5]].tolist()


def test_an_eye_that_nothing_names_is_said(written: Written) -> None:
    (path,) = written.path.rglob("*_recording-glasseseye1_physio.json")
    assert json.loads(path.read_text("utf-8"))["RecordedEye"] == "cyclopean"
    assert any(note.startswith("glasses: no header says which eye") for note in written.notes)


def test_gaze_without_x_and_y_is_a_table_as_any_other(exported: Exporting) -> None:
    content = made.xdf(stream(1, "odd", GAZE_VALUES, times(600, 60.0), rate=60.0, kind="Gaze"))
    (found,) = exported(content, "bids").written
    (path,) = found.path.rglob("*_recording-odd_physio.json")
    assert json.loads(path.read_text("utf-8"))["PhysioType"] == "generic"
    assert any("no channels are known to be x and y" in note for note in found.notes)


# Rows for samples whose times are what they are.
def _header(rate: float, *, drops: bool = True) -> RecordedHeader:
    return RecordedHeader(
        name="a",
        content_type="ECG",
        source_id="",
        hostname="",
        channel_count=1,
        format=ChannelFormat.FLOAT32,
        rate=rate,
        created_at=0.0,
        labels=("1",),
        units=("",),
        can_drop_samples=drops,
        identity=None,
        data_name="",
        refused="",
    )


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=60), st.integers(-60, 60))
def test_every_sample_has_a_row_of_its_own_in_the_order_of_the_file(
    places: list[float], after: int
) -> None:
    rows = place(np.array(places), after)
    assert rows[0] > after
    assert (np.diff(rows) > 0).all()


@given(st.lists(st.integers(1, 9), min_size=1, max_size=60), st.floats(-0.49, 0.49))
def test_what_has_its_own_row_is_in_it(steps: list[int], phase: float) -> None:
    true = np.cumsum(steps)
    assert place(true + phase, 0).tolist() == true.tolist()


@given(st.lists(st.integers(0, 7), min_size=1, max_size=5))
def test_no_other_rows_are_nearer_to_all_together(places: list[int]) -> None:
    found = place(np.array(places, float), -100)
    cost = np.abs(found - places).sum()
    others = combinations(range(-5, 13), len(places))
    assert cost == min(sum(map(abs, np.subtract(each, places))) for each in others)


@pytest.mark.parametrize("late", [-7.0, 7.0])
def test_one_wrong_stamp_moves_no_other_sample(late: float) -> None:
    places = np.arange(100.0)
    places[50] += late
    assert place(places, -1).tolist() == list(range(100))


def test_the_rate_is_that_between_gaps() -> None:
    times = np.arange(5000) / 129.87
    times[2000:] += 3.3333
    noisy = times + np.random.default_rng(1).normal(0, 1e-4, len(times))
    timing = find_timing(np.array_split(noisy, 77), _header(130.0))
    assert timing is not None
    assert timing.rate_hz == pytest.approx(129.87, rel=1e-6)
    assert (timing.gaps, timing.longest_gap_s) == (1, pytest.approx(3.3333 + 1 / 129.87, abs=1e-3))
    (part,) = timing.parts
    assert part.count == 5000
    assert part.start_s == pytest.approx(0.0, abs=1e-4)


def test_the_rate_is_not_that_of_stamps_which_all_come_at_once() -> None:
    times = np.arange(20000) / 249.95
    times[5000:8000] = times[8000] - np.arange(3000, 0, -1) * 1e-6
    timing = find_timing(np.array_split(times, 11), _header(250.0))
    assert timing is not None
    assert timing.rate_hz == pytest.approx(249.95, rel=1e-4)


@pytest.mark.parametrize(
    "times", [np.zeros(500), np.array([1.0, 1.001]), np.array([3.0]), np.arange(40) * 1e-6]
)
def test_what_tells_no_rate_has_the_nominal_one(times: np.ndarray) -> None:
    timing = find_timing([times], _header(50.0))
    assert timing is not None
    assert timing.rate_hz == 50.0


def test_no_sample_has_no_timing() -> None:
    assert find_timing([], _header(50.0)) is None


# Recordings of a study become one data set, which is never overwritten.
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
        task = Task(("bids",), Selection(), output=place, whose=whose)
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


def test_nothing_is_added_while_a_spreadsheet_has_the_participants_open(
    tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _add(root, _recording(tmp_path, "P01"))
    before = _files(root)
    hold_open(monkeypatch, root / "participants.tsv")
    with pytest.raises(RecordingError, match=SENTENCE) as caught:
        _add(root, _recording(tmp_path, "P02"))
    assert str(caught.value).startswith(f"cannot write {root / 'participants.tsv'}: ")
    monkeypatch.undo()
    assert _files(root) == before
    assert _add(root, _recording(tmp_path, "P02")) is not None
    assert list(_people(root)) == ["sub-P01", "sub-P02"]


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
    with pytest.raises(RecordingError, match=r"is already in the data set, from another recording"):
        _add(root, other)
    assert _files(root) == before


# Where only the case differs, it is one folder on a disk that ignores it.
@pytest.mark.parametrize(("first", "second"), [("P-01", "P01"), ("P01", "p01")])
def test_two_people_of_one_label_are_not_mixed(
    first: str, second: str, tmp_path: Path, root: Path
) -> None:
    _add(root, _recording(tmp_path, first, "one_task-walk.xdf"))
    before = _files(root)
    said = f"sub-P01 is '{first}' in the data set and '{second}' in this"
    with pytest.raises(RecordingError, match=said):
        _add(root, _recording(tmp_path, second, "two_task-talk.xdf"))
    assert _files(root) == before


@pytest.mark.parametrize("session", ["a", "A"])
def test_two_recordings_of_different_sensors_do_not_become_one_run(
    session: str, tmp_path: Path, root: Path
) -> None:
    strap, band = (DeviceIdentity(each, "A1", "P01") for each in ("polar_h10", "emotibit"))
    morning, evening = tmp_path / "sub-P01_ses-a_task-walk.xdf", tmp_path / "evening"
    evening.mkdir()
    evening /= f"sub-P01_ses-{session}_task-walk.xdf"
    morning.write_bytes(made.xdf(ours(1, strap, "ecg", numbers(9), times(9, 1.0), rate=1.0)))
    later = (each + 3600.0 for each in times(9, 1.0))
    evening.write_bytes(made.xdf(ours(1, band, "eda", numbers(9), later, rate=1.0)))
    _add(root, morning)
    before = _files(root)
    with pytest.raises(RecordingError, match=r"ses-a.* is already in the data set, from another"):
        _add(root, evening)
    assert _files(root) == before


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
    with pytest.raises(ConfigError, match="is not a BIDS data set"):
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
