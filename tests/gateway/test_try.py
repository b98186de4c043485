"""``biosensor-gateway try``: what its recording must have, and how it begins and ends."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest

from biosensor_gateway.cli.trial import expected_streams, print_verdict
from biosensor_gateway.demo.demonstration import first_devices
from biosensor_gateway.recording.xdf.expectation import by_name
from biosensor_gateway.recording.xdf.verdict import Colour, check
from tests.xdf import xdf_file as x

ADDRESS = re.compile(r"http://127\.0\.0\.1:\d+/door\?token=\S+")


def _status(sensor: str) -> dict[str, Any]:
    return {"devices": [{"sensor": sensor, "unit": "virtual", "participant": "", "label": ""}]}


def test_it_shows_a_few_sensors_and_all_on_request() -> None:
    assert {"polar_h10", "shimmer3_gsr"} < set(first_devices())
    assert len(first_devices()) <= 4


def test_a_recording_must_have_samples_of_what_is_measured_and_the_rest_must_be_there() -> None:
    expected = {
        each.name: each.must_have_samples
        for each in expected_streams(_status("polar_h10"), {"polar_h10": "polar_h10"}, 10.0)
    }
    prefix = "polar_h10-virtual"
    assert all(expected[f"{prefix}-{each}"] for each in ("ecg", "acc", "hr", "ibi"))
    # Told when it connected, and then when it changes.
    assert not expected[f"{prefix}-bat"]


def test_what_a_device_cannot_fill_in_so_short_a_time_is_not_demanded() -> None:
    devices = {"empatica_e4": "empatica_e4"}
    expected = {each.name: each for each in expected_streams(_status("empatica_e4"), devices, 10.0)}
    # Nobody presses its button.
    assert not expected["empatica_e4-virtual-tag"].must_have_samples


def test_a_stream_that_is_missing_in_the_recording_is_said_and_is_red(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.xdf"
    file.write_bytes(x.xdf(*x.regular(1, "a", [1000 + k / 10 for k in range(300)], 10.0)))
    verdict = check(file, by_name(["a", "b"]))
    print_verdict(verdict)
    said = capsys.readouterr().out
    assert verdict.colour is Colour.RED
    assert "error: b: it was expected and is not in the recording" in said
    assert re.search(r"^ a +300 +0 +- *$", said, re.MULTILINE)


def _start(folder: Path, *options: str) -> subprocess.Popen[str]:
    """Start it as in a terminal: Ctrl-C reaches all that it starts."""
    # The folders of its user are not to be touched, so they are there to be looked at.
    variables = {"HOME": str(folder / "home"), "BIOSENSOR_GATEWAY_SETTINGS": str(folder / "no")}
    return subprocess.Popen(
        [sys.executable, "-m", "biosensor_gateway.cli", "try", "--no-open", *options],
        cwd=folder,
        env={**os.environ, **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


@pytest.mark.nightly
def test_ctrl_c_before_the_recording_ends_all_of_it_and_says_so(tmp_path: Path) -> None:
    process = _start(tmp_path)
    said = _said_until(process, ADDRESS)
    os.killpg(process.pid, signal.SIGINT)
    rest, _ = process.communicate(timeout=60)
    assert process.returncode == 1, said + rest
    assert "Ended before all of it was shown." in rest
    assert not _remaining(process.pid)
    assert not (tmp_path / "home").exists()


@pytest.mark.nightly
def test_quit_of_the_page_ends_all_of_it(tmp_path: Path) -> None:
    process = _start(tmp_path, "--folder", "kept")
    said = _said_until(process, re.compile("until you press Ctrl-C"))
    found = ADDRESS.search(said)
    assert found is not None, said
    _quit(found[0])
    rest, _ = process.communicate(timeout=60)
    assert "The page was ended in the browser." in rest
    # The table of topics, where there is ROS, had a moment only.
    assert process.returncode in (0, 1, 3), said + rest
    assert not _remaining(process.pid)


def _quit(address: str) -> None:
    """Press *Quit* as a browser would that has opened the page."""
    origin, _, path = address.partition("/door")
    connection = HTTPConnection(origin.removeprefix("http://"), timeout=30)
    connection.request("GET", f"/door{path}")
    opened = connection.getresponse()
    opened.read()
    cookie = opened.headers["Set-Cookie"].partition(";")[0]
    headers = {"Cookie": cookie, "Origin": origin, "Content-Type": "application/json"}
    connection.request("POST", "/api/v1/quit", b'{"rest": "end"}', headers)
    answer = connection.getresponse()
    answer.read()
    connection.close()
    assert answer.status == 200


def _said_until(process: subprocess.Popen[str], sign: re.Pattern[str]) -> str:
    assert process.stdout is not None
    said = ""
    while not sign.search(said):
        line = process.stdout.readline()
        assert line, said
        said += line
    return said


@pytest.mark.nightly
def test_it_ends_by_itself_having_recorded_and_made_tables(tmp_path: Path) -> None:
    process = _start(tmp_path, "--seconds", "12", "--folder", "kept")
    said, _ = process.communicate(timeout=170)
    # 3 says that this computer is too busy for all topics, where there is ROS.
    assert process.returncode in (0, 3), said
    # What was told before the table began is in it all the same.
    assert "not expected" not in said
    (recording,) = (tmp_path / "kept").glob("*.xdf")
    assert check(recording).colour is not Colour.RED
    (tables,) = (tmp_path / "kept").glob("*_csv")
    assert len((tables / "polar_h10-virtual-ecg.csv").read_text().splitlines()) > 1000
    assert not _remaining(process.pid)
    assert not (tmp_path / "home").exists()


def _remaining(session: int) -> list[str]:
    listed = subprocess.run(
        ["ps", "-o", "args=", "-s", str(session)], capture_output=True, text=True, check=False
    )
    return listed.stdout.splitlines()
