"""EMG and gaze in a BIDS dataset: where each is, what its channels are called, what is said."""

from __future__ import annotations

import csv
import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from edfio import read_bdf

from biosensor_gateway.recording.export.outcome import Written
from tests.recording_export.bids_shapes import (
    EMG_VALUES,
    GAZE_VALUES,
    muscles_and_eyes,
    stream,
    times,
)
from tests.recording_export.conftest import Exporting
from tests.xdf import xdf_file as made


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
    for place, signal in enumerate(signals):
        data = signal.data
        assert np.abs(data[:3000] - EMG_VALUES[:3000, place]).max() <= 2 * step
        assert np.abs(data[4024:7024] - EMG_VALUES[3000:, place]).max() <= 2 * step
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
    assert any("no channel is known as x and y" in note for note in found.notes)
