"""Other people's readers read what is exported, and find in it what was recorded."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.export.exporter import Clock
from biosensor_gateway.recording.export.job import Task, export
from tests.recording_export.study import BEGIN_S, ecg_values, study

pytestmark = pytest.mark.nightly

PEERS = Path(__file__).parent
ENVIRONMENT = PEERS.parents[1] / ".venv-peers"
DEADLINE_S = 120.0
ECG, RR, GSR = "P1-polar_h10-U1-ecg", "P1-polar_h10-U1-ibi", "P2-empatica_e4-U1-gsr"


FILES = {
    "table": ("csv", f"study_csv/{ECG}.csv"),
    "holes": ("csv", f"study_csv/{GSR}.csv"),
    "long": ("long", "study.csv.gz"),
    "bdf": ("edf", f"study_edf/{ECG}_run1.bdf"),
    "intervals": ("kubios", f"study_kubios/{RR}.txt"),
    "conductance": ("ledalab", f"study_ledalab/{GSR}.txt"),
}


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """The study in all formats, as others read it; by one process, for it loads a lot."""
    # A skip would pass where nothing was tried.
    if not (ENVIRONMENT / ".installed").exists():
        pytest.fail("the peers are not installed: run `make venv-peers` first")
    path = tmp_path_factory.mktemp("export") / "study.xdf"
    path.write_bytes(study())
    formats = ("csv", "csv-long.gz", "kubios", "ledalab")
    export(path, Task(formats, Selection()), lambda _name, _s: lambda _done: None)
    export(path, Task(["edf"], Selection(), clock=Clock.WALL), lambda _name, _s: lambda _done: None)
    wanted = {name: (kind, str(path.parent / file)) for name, (kind, file) in FILES.items()}
    done = subprocess.run(
        [
            ENVIRONMENT / "bin" / "python",
            PEERS / "export_reads.py",
            *(f"{kind}={file}" for kind, file in wanted.values()),
        ],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    return {name: found[file] for name, (_, file) in wanted.items()}


def test_pandas_reads_a_table_without_options(read: dict[str, dict[str, Any]]) -> None:
    found = read["table"]
    assert found["types"] == {"lsl_time": "float64", "seconds": "float64", "ECG": "float64"}
    values = np.array(found["columns"]["ECG"], np.float32)
    assert values.tolist() == ecg_values(2600)[:, 0].tolist()
    assert found["columns"]["lsl_time"][0] == BEGIN_S
    conductance = read["holes"]
    assert np.flatnonzero(np.isnan(conductance["columns"]["EDA"])).tolist() == [7]


def test_pandas_reads_the_long_table(read: dict[str, dict[str, Any]]) -> None:
    found = read["long"]
    assert {name: found["counts"][name] for name in (ECG, RR, GSR)} == {ECG: 2600, RR: 19, GSR: 79}
    assert f"{ECG}/ECG" in found["columns"]
    assert 'say "no",\nthen stop' in found["texts"]


def test_mne_reads_bdf(read: dict[str, dict[str, Any]]) -> None:
    found = read["bdf"]
    assert (found["names"], found["rate_hz"], found["person"]) == (["ECG"], 130.0, "P1")
    assert found["begun"].startswith("2026-09-21T14:13:20")
    microvolts = np.array(found["microvolts"])[0]
    np.testing.assert_allclose(microvolts, ecg_values(2600)[:1300, 0], rtol=0, atol=1e-3)
    # MNE counts from the whole second in the header or from the first sample, by its version.
    (begin, _, told), (marked, _, text) = found["told"]
    assert (told, text) == (f"LSL time {BEGIN_S:.6f} s", "go")
    assert marked - begin == pytest.approx(3.0, abs=1e-4)


def test_neurokit_takes_the_intervals(read: dict[str, dict[str, Any]]) -> None:
    found = read["intervals"]
    assert found["intervals"] == [0.8] * 19
    assert found["mean_ms"] == pytest.approx(800)


def test_neurokit_takes_the_conductance(read: dict[str, dict[str, Any]]) -> None:
    found = read["conductance"]
    assert len(found["times"]) == 79
    assert [code for code in found["markers"] if code] == [1, 2]
    np.testing.assert_allclose(found["again"], found["conductance"], atol=1e-9)
