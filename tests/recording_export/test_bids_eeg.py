"""EEG in a BIDS dataset: every bit, gaps as events and runs, every marker in one of the runs."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tests.recording_export.bids_shapes import BEGIN_S, EEG_VALUES, eeg, stream, times
from tests.recording_export.conftest import Exporting
from tests.xdf import xdf_file as made


def _folder(exported: Exporting, content: bytes) -> Path:
    (written,) = exported(content, "bids").written
    return written.path / "sub-unknown" / "eeg"


def _samples(path: Path) -> np.ndarray:
    header = path.with_suffix(".vhdr").read_text("utf-8")
    kind = np.dtype("<i2" if "BinaryFormat=INT_16" in header else "<f4")
    return np.frombuffer(path.read_bytes(), kind).reshape(-1, 2)


def _events(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))


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
    found = [_events(each) for each in sorted(folder.glob("*_events.tsv"))]
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
