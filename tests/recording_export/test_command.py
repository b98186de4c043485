"""``xdf export`` as a process: what it prints and writes, and its exit codes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from subprocess import PIPE

import pytest

from tests.recording_export.study import study
from tests.rigs.terminal import at_terminal
from tests.xdf import xdf_file as made
from tests.xdf.conftest import Command

pytestmark = pytest.mark.nightly


@pytest.mark.seam
def test_a_person_is_cut_out(tmp_path: Path) -> None:
    command = Command(tmp_path)
    options = ("--to", "csv-long", "--to", "ledalab", "--without", "P1", "--until", "0:15")
    path = str(command.recording)
    code, printed, said = command(path, *options, content=study(), command="export")
    assert (code, said) == (0, "")
    table = (tmp_path / "study.csv").read_text()
    assert '"P2"' in table
    assert '"P1"' not in table
    assert re.search(r"^wrote .*study\.csv \(\d", printed, re.MULTILINE)
    again, printed, said = command(path, *options, command="export")
    assert (again, printed) == (2, "")
    assert said.startswith(f"biosensor-gateway: {tmp_path / 'study.csv'} exists")


def test_json_and_a_damaged_recording(tmp_path: Path) -> None:
    command = Command(tmp_path)
    options = ("--to", "csv", "--json", "--output", str(tmp_path / "tables"))
    content = study()[:-500]
    code, printed, said = command(
        str(command.recording), *options, content=content, command="export"
    )
    told = json.loads(printed)
    # As `xdf check` has it of a damaged file.
    assert (code, said) == (1, "")
    assert told["damages"][0]["breaks_off"]
    assert told["written"][0]["path"] == str(tmp_path / "tables")
    assert told["written"][0]["bytes"] > 10_000
    assert told["streams"][0]["samples"] == 2600


def test_a_wrong_command_is_one_sentence(tmp_path: Path) -> None:
    command = Command(tmp_path)
    path = str(command.recording)
    for options in (
        ("--to", "excel"),
        ("--to", "csv", "--clock", "wall", "--streams", "none*"),
        ("--to", "csv", "--from", "soon"),
        ("--to", "csv", "--output", str(tmp_path / "none" / "x")),
    ):
        code, printed, said = command(path, *options, content=study(), command="export")
        assert (code in {1, 2}, printed) == (True, "")
        assert len(said.splitlines()) == 1
    assert [each.name for each in tmp_path.iterdir()] == ["study.xdf"]


def test_it_fits_a_terminal_of_80_columns(tmp_path: Path) -> None:
    name = "participant-0123-left-upper-arm-polar_h10-" + "E621E1F8-C36C-495A-93FC-0C247A3E6E5F"
    header, samples, _ = made.regular(1, name, [100 + k / 10 for k in range(300)], 10.0)
    path = tmp_path / "study.xdf"
    path.write_bytes(made.xdf(header, samples, b"\xee" * 30, samples, samples[:-1]))
    formats = ("--to", "csv", "--to", "edf", "--to", "csv-long.gz")
    line = [sys.executable, "-m", "biosensor_gateway.cli", "xdf", "export", str(path), *formats]
    with at_terminal(line, os.environ, columns=80) as terminal:
        assert terminal.exit_code() == 1
        shown = re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", terminal.raw)
    lines = [each.rstrip() for part in shown.split("\r\n") for each in part.split("\r")]
    # A path that is longer than a line stays whole.
    assert all(len(each) <= 80 or " " not in each.strip() for each in lines)
    assert " ".join(shown.split()).count("wrote ") == 3


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
@pytest.mark.parametrize("format_name", ["csv", "bids", "edf", "mcap"])
def test_what_is_ended_leaves_nothing_half_done(
    tmp_path: Path, format_name: str, number: signal.Signals
) -> None:
    stamps = [100 + k / 1000 for k in range(300_000)]
    header, samples, _ = made.regular(1, "P01-polar_h10-A-ecg", stamps, 1000.0)
    (tmp_path / "study.xdf").write_bytes(made.xdf(header, samples))
    line = [sys.executable, "-m", "biosensor_gateway.cli", "xdf", "export", "study.xdf"]
    with subprocess.Popen([*line, "--to", format_name], cwd=tmp_path, stderr=PIPE) as running:
        while running.poll() is None and not list(tmp_path.rglob("*.part/**/*")):
            time.sleep(0.001)
        running.send_signal(number)
        _, said = running.communicate()
    assert running.returncode not in {0, -number}
    assert b"Traceback" not in said
    assert [each.name for each in tmp_path.iterdir()] == ["study.xdf"]
