"""Other people's readers read what is exported, and find in it what was recorded."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.recording.contents.choice import Wish
from biosensor_gateway.recording.export.exporter import Clock
from biosensor_gateway.recording.export.exporting import Task, export
from tests.recording_export.study import BEGIN_S, ecg_values, study

PEERS = Path(__file__).parent
ENVIRONMENT = PEERS.parents[1] / ".venv-peers"
DEADLINE_S = 120.0
ECG, RR, GSR = "P1-polar_h10-U1-ecg", "P1-polar_h10-U1-ibi", "P2-empatica_e4-U1-gsr"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study in all formats."""
    # A skip would pass where nothing was tried.
    if not (ENVIRONMENT / ".installed").exists():
        pytest.fail("the peers are not installed: run `make test`, or tests/peers/install.sh first")
    path = tmp_path_factory.mktemp("export") / "study.xdf"
    path.write_bytes(study())
    formats = ("csv", "csv-long.gz", "kubios", "ledalab")
    export(path, Task(formats, Wish()), lambda _name, _s: lambda _done: None)
    export(path, Task(["edf"], Wish(), Clock.WALL), lambda _name, _s: lambda _done: None)
    return path.parent


def _read(kind: str, path: Path) -> dict[str, Any]:
    done = subprocess.run(
        [ENVIRONMENT / "bin" / "python", PEERS / "export_reads.py", kind, path],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_pandas_reads_a_table_without_options(folder: Path) -> None:
    read = _read("csv", folder / "study_csv" / f"{ECG}.csv")
    assert read["types"] == {"lsl_time": "float64", "ECG": "float64"}
    values = np.array(read["columns"]["ECG"], np.float32)
    assert values.tolist() == ecg_values(2600)[:, 0].tolist()
    assert read["columns"]["lsl_time"][0] == BEGIN_S
    conductance = _read("csv", folder / "study_csv" / f"{GSR}.csv")
    assert np.flatnonzero(np.isnan(conductance["columns"]["EDA"])).tolist() == [7]


def test_pandas_reads_the_long_table(folder: Path) -> None:
    read = _read("long", folder / "study.csv.gz")
    assert {name: read["counts"][name] for name in (ECG, RR, GSR)} == {ECG: 2600, RR: 19, GSR: 79}
    assert f"{ECG}/ECG" in read["columns"]
    assert 'say "no",\nthen stop' in read["texts"]


def test_mne_reads_bdf(folder: Path) -> None:
    read = _read("edf", folder / "study_edf" / f"{ECG}_1.bdf")
    assert (read["names"], read["rate_hz"], read["person"]) == (["ECG"], 130.0, "P1")
    assert read["begun"].startswith("2026-09-21T14:13:20")
    microvolts = np.array(read["microvolts"])[0]
    np.testing.assert_allclose(microvolts, ecg_values(2600)[:1300, 0], rtol=0, atol=1e-3)
    # MNE counts from the whole second in the header or from the first sample, by its version.
    (begin, _, told), (marked, _, text) = read["told"]
    assert (told, text) == (f"LSL time {BEGIN_S:.6f} s", "go")
    assert marked - begin == pytest.approx(3.0, abs=1e-4)


def test_neurokit_takes_the_intervals(folder: Path) -> None:
    read = _read("kubios", folder / "study_kubios" / f"{RR}.txt")
    assert read["intervals"] == [0.8] * 19
    assert read["mean_ms"] == pytest.approx(800)


def test_neurokit_takes_the_conductance(folder: Path) -> None:
    read = _read("ledalab", folder / "study_ledalab" / f"{GSR}.txt")
    assert len(read["times"]) == 79
    assert [code for code in read["markers"] if code] == [1, 2]
    np.testing.assert_allclose(read["again"], read["conductance"], atol=1e-9)
