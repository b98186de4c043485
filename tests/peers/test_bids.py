"""The validator of BIDS finds no error in any dataset, and pandas reads what was recorded."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.export.bids.study import Study
from biosensor_gateway.recording.export.exporter import Times
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.export.outcome import Outcome
from tests.peers.test_peers import DEADLINE_S, ENVIRONMENT, PEERS
from tests.recording_export.bids_shapes import (
    BEGIN_S,
    EEG_VALUES,
    EMG_VALUES,
    SHAPES,
    eeg,
    h10,
    numbers,
    times,
)
from tests.xdf import xdf_file as made

pytestmark = pytest.mark.nightly


def _run(program: str, *arguments: str) -> str:
    # A skip would pass where nothing was tried.
    if not (ENVIRONMENT / ".installed").exists():
        pytest.fail("the peers are not installed: run `make venv-peers` first")
    line = [str(ENVIRONMENT / "bin" / program), *arguments]
    done = subprocess.run(line, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.stdout, done.stderr
    return done.stdout


def _validated(dataset: Path) -> list[dict[str, Any]]:
    """All issues that the validator names; it reads every row, not only the first thousand."""
    told = _run("bids-validator-deno", "--max-rows", "-1", "--format", "json", str(dataset))
    return json.loads(told)["issues"]["issues"]


def _exported(tmp_path: Path, shape: str) -> Path:
    path = tmp_path / "study.xdf"
    path.write_bytes(SHAPES[shape])
    (written,) = export(
        path, Task(["bids"], Selection()), lambda _name, _s: lambda _done: None
    ).written
    return written.path


@pytest.mark.parametrize("shape", SHAPES)
def test_the_validator_finds_no_error(shape: str, tmp_path: Path) -> None:
    issues = _validated(_exported(tmp_path, shape))
    assert [each for each in issues if each["severity"] == "error"] == []
    # What it warns of, only people know: authors, licence, institution, instructions.
    told = {each["code"] for each in issues}
    assert told <= {
        "EVENTS_TSV_MISSING",
        "JSON_KEY_RECOMMENDED",
        "NO_AUTHORS",
        "SIDECAR_KEY_RECOMMENDED",
        "TOO_FEW_AUTHORS",
    }


def test_the_validator_finds_no_error_in_the_data_set_of_a_study(tmp_path: Path) -> None:
    root = tmp_path / "study"
    for person in ("p01", "p02", "p03"):
        recording = tmp_path / f"sub-{person}_task-walk_run-001_beh.xdf"
        recording.write_bytes(made.xdf(h10(1, person)))

        def export_to(place: Path, recording: Path = recording) -> Outcome:
            task = Task(["bids"], Selection(), output=place)
            return export(recording, task, lambda _name, _s: lambda _done: None)

        Study(root).add(recording, export_to)
    assert [each for each in _validated(root) if each["severity"] == "error"] == []


def test_the_validator_finds_an_error_where_there_is_one(tmp_path: Path) -> None:
    dataset = _exported(tmp_path, "one person")
    (sidecar,) = dataset.rglob("*ecg_physio.json")
    content = json.loads(sidecar.read_text("utf-8"))
    del content["SamplingFrequency"]
    sidecar.write_text(json.dumps(content), "utf-8")
    codes = {each["code"] for each in _validated(dataset) if each["severity"] == "error"}
    assert codes == {"SIDECAR_KEY_REQUIRED"}


def test_pandas_reads_every_bit(tmp_path: Path) -> None:
    tables = sorted(map(str, _exported(tmp_path, "two persons").rglob("*_physio.tsv.gz")))
    found = json.loads(_run("python", str(PEERS / "physio_reads.py"), *tables))
    assert len(found) == 2
    for table in found:
        assert table["columns"] == ["timestamp", "ECG"]
        assert table["rows"] == 1000
        bits = numbers(960).ravel().view(np.uint32)
        nan = np.isnan(numbers(960).ravel())
        read = np.array(table["bits"]["ECG"], np.uint32)
        # No value has no certain bits.
        assert np.isnan(read.view(np.float32)).tolist() == nan.tolist()
        assert read[~nan].tolist() == bits[~nan].tolist()
        at = np.delete(times(1000, 130.0), slice(300, 340)) - BEGIN_S
        np.testing.assert_allclose(table["timestamps"], at, rtol=0, atol=1e-6)


def test_mne_reads_the_samples_of_eeg_and_what_happened(tmp_path: Path) -> None:
    path = tmp_path / "sub-p01_task-walk_eeg.xdf"
    path.write_bytes(eeg())
    (written,) = export(
        path, Task(["bids"], Selection()), lambda _name, _s: lambda _done: None
    ).written
    assert [each for each in _validated(written.path) if each["severity"] == "error"] == []
    found = json.loads(_run("python", str(PEERS / "eeg_reads.py"), str(written.path), "eeg"))
    assert [each["rate"] for each in found] == [pytest.approx(250.0)] * 2
    first, second = (np.array(each["bits"], np.uint32).view(np.float32) for each in found)
    truth = EEG_VALUES.ravel()
    before, after = first[: 2000 * 2], first[2500 * 2 :]
    # MNE has volts, so a value is the recorded one but for the last bit.
    assert np.abs(before - truth[: 2000 * 2]).max() <= np.spacing(np.abs(truth).max())
    assert np.isnan(first[2000 * 2 : 2500 * 2]).all()
    assert np.abs(after - truth[2000 * 2 : 4000 * 2]).max() <= np.spacing(np.abs(truth).max())
    assert np.abs(second - truth[4000 * 2 :]).max() <= np.spacing(np.abs(truth).max())
    assert found[0]["channels"] == ["Fz", "Cz"]
    assert found[0]["types"] == ["eeg", "eeg"]
    told = [(round(on, 3), round(length, 3), text) for on, length, text in found[0]["annotations"]]
    assert told == [(1.0, 0.0, "a"), (8.0, 2.0, "BAD_gap"), (9.0, 0.0, "b, c")]


def test_mne_reads_the_samples_of_emg_and_where_a_gap_is(tmp_path: Path) -> None:
    dataset = _exported(tmp_path, "muscles and eyes")
    found = json.loads(_run("python", str(PEERS / "eeg_reads.py"), str(dataset), "emg"))
    (leg,) = (each for each in found if len(each["channels"]) == 2)
    assert (leg["rate"], leg["channels"], leg["types"]) == (
        pytest.approx(512.0),
        ["EMG1", "EMG2"],
        ["emg", "emg"],
    )
    millivolts = np.array(leg["bits"], np.uint32).view(np.float32).reshape(-1, 2) * 1e-3
    step = 2 * np.abs(EMG_VALUES).max() / (1 << 24)
    assert np.abs(millivolts[:3000] - EMG_VALUES[:3000]).max() <= 2 * step
    assert np.abs(millivolts[4024:7024] - EMG_VALUES[3000:]).max() <= 2 * step
    told = {text: (onset, length) for onset, length, text in leg["annotations"]}
    assert told["BAD_gap"] == (pytest.approx(3000 / 512), pytest.approx(2.0))
    assert told["go"][0] == pytest.approx(1.0)


@pytest.mark.parametrize("shape", ["one person", "muscles and eyes"])
def test_the_validator_finds_no_error_with_even_times(shape: str, tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    path.write_bytes(SHAPES[shape])
    task = Task(["bids"], Selection(), times=Times.EVEN)
    (written,) = export(path, task, lambda _name, _s: lambda _done: None).written
    assert [each for each in _validated(written.path) if each["severity"] == "error"] == []
