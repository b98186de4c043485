"""The examples that load each format, a notebook and a script for R, run as they stand."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.export.job import Task, export
from tests.peers.test_peers import DEADLINE_S, ENVIRONMENT, PEERS
from tests.recording_export.study import study

EXAMPLES = PEERS.parents[1] / "examples" / "recordings"
FORMATS = ("csv", "edf", "kubios", "ledalab", "bids", "mcap")

pytestmark = pytest.mark.nightly


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A recording with its exports."""
    path = tmp_path / "study.xdf"
    path.write_bytes(study())
    export(path, Task(FORMATS, Selection()), lambda _name, _s: lambda _done: None)
    return tmp_path


def _said(folder: Path, *command: str) -> str:
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=DEADLINE_S, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_notebook_finds_the_same_in_each_format(folder: Path) -> None:
    # A skip would pass where nothing was tried.
    if not (ENVIRONMENT / ".installed").exists():
        pytest.fail("the peers are not installed: run `make venv-peers` first")
    python, program = str(ENVIRONMENT / "bin/python"), str(PEERS / "notebook_runs.py")
    said = _said(folder, python, program, str(EXAMPLES / "load_exports.ipynb"))
    assert "650 of them without a sample" in said
    assert said.endswith("the same in all\n")


def test_r_finds_the_same_in_each_format(folder: Path) -> None:
    if shutil.which("Rscript") is None:
        pytest.fail("R is not installed: it is among tests/system/packages.txt")
    said = _said(folder, "Rscript", "--vanilla", str(EXAMPLES / "load_exports.R"), "study")
    assert "650 of them without a sample" in said
    assert said.endswith("the same in all\n")
