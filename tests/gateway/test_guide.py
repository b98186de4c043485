"""Commands that lead a person: ``run`` without settings, and ``try``."""

from __future__ import annotations

import errno
import os
import re
import signal
import socket
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest

from biosensor_common.errors import ConfigError, ConfigReason, TransportError
from biosensor_gateway.cli import trial
from biosensor_gateway.cli.trial import (
    Trial,
    expected_streams,
    late_status,
    print_verdict,
    require_writable,
)
from biosensor_gateway.demo.demonstration import first_devices
from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.registry import sensor_names, settings_models
from biosensor_gateway.recording.xdf.verdict import Colour, by_name, check
from biosensor_gateway.settings.editor import add_device
from biosensor_gateway.settings.file import load_settings
from tests.rigs.terminal import Terminal, at_terminal
from tests.xdf import xdf_file as x

# ``run`` without settings: it leads to a stream, whatever is typed at each question.

# Virtual devices are in the air around the program, as real ones would be.
_CODE = """
import sys
from biosensor_gateway.cli import main
from biosensor_gateway.demo.virtual_devices import simulated_settings
with simulated_settings({names!r}):
    sys.argv = ["biosensor-gateway", "run", *{arguments!r}]
    main()
"""
MENU, WHICH = "Type a number, then Enter [1]:", "Enter to go back:"
STREAMING = re.compile(r"^Polar H10 +streaming", re.MULTILINE)
NO_ANSWERS = ["0", "4", "-1", "1.5", "one", "9" * 5000, "1 2", b"\xff\xfe", "\u0661", "\x1b[A"]


def program(*names: str, arguments: tuple[str, ...] = ()) -> list[str]:
    return [sys.executable, "-c", _CODE.format(names=list(names), arguments=list(arguments))]


def environment(folder: Path) -> Mapping[str, str]:
    return os.environ | {
        "BIOSENSOR_GATEWAY_STATE": str(folder / "state"),
        "BIOSENSOR_GATEWAY_SETTINGS": str(folder / "config" / "settings.toml"),
        "TERM": "xterm",
        "PYTHONUTF8": "1",
    }


def answer(terminal: Terminal, prompt: str, text: str | bytes) -> None:
    """Answer the question that was asked last."""
    asked = terminal.until(lambda seen: seen.endswith(prompt))
    terminal.type((text if isinstance(text, bytes) else text.encode()) + b"\n")
    terminal.until(lambda seen: seen != asked)


@pytest.mark.seam
def test_it_leads_from_nothing_to_a_stream_and_knows_the_way_the_next_time(tmp_path: Path) -> None:
    settings = tmp_path / "config" / "settings.toml"
    with at_terminal(program("polar_h10"), environment(tmp_path)) as terminal:
        terminal.until_seen("No sensor is set up yet")
        for wrong in NO_ANSWERS:
            answer(terminal, MENU, wrong)
        answer(terminal, MENU, "")
        assert terminal.until_seen(WHICH).count("is not in the list") == len(NO_ANSWERS)
        assert not settings.exists()
        answer(terminal, WHICH, "2")
        answer(terminal, WHICH, "1 x")
        answer(terminal, WHICH, "1, 1")
        shown = terminal.until(STREAMING.search)
        assert shown.count("is not in the list") == len(NO_ANSWERS) + 2
        assert "no problem found" in shown
        assert "Traceback" not in shown
        terminal.type("\x03")
        assert terminal.exit_code() == 0
    (device,) = load_settings(settings, settings_models()).devices
    assert (device.sensor, device.unit) == ("polar_h10", "A1B2C3D4")
    with at_terminal(program("polar_h10"), environment(tmp_path)) as terminal:
        shown = terminal.until(STREAMING.search)
        assert MENU not in shown
        terminal.type("\x03")
        assert terminal.exit_code() == 0


@pytest.mark.nightly
def test_whoever_has_no_sensor_gets_virtual_ones_and_no_settings(tmp_path: Path) -> None:
    with at_terminal([*_plain(), "run"], environment(tmp_path)) as terminal:
        answer(terminal, MENU, "2")
        answer(terminal, "Enter for all:", "0")
        answer(terminal, "Enter for all:", str(len(sensor_names()) + 1))
        shown = terminal.until(lambda seen: seen.endswith("Enter for all:"))
        (number,) = re.findall(r"^ +(\d+) +Polar H10$", shown, re.MULTILINE)
        answer(terminal, "Enter for all:", number)
        terminal.until(STREAMING.search)
        terminal.type("\x03")
        assert terminal.exit_code() == 0
    assert not (tmp_path / "config").exists()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("typed", "code"), [("3\n", 0), ("\x03", 0), ("\x04", 2)], ids=["End", "Ctrl-C", "Ctrl-D"]
)
def test_it_can_be_left(tmp_path: Path, typed: str, code: int) -> None:
    with at_terminal([*_plain(), "run"], environment(tmp_path)) as terminal:
        terminal.until(lambda seen: seen.endswith(MENU))
        terminal.type(typed)
        assert terminal.exit_code() == code
    assert "Traceback" not in terminal.screen.text
    assert not (tmp_path / "config").exists()


@pytest.mark.nightly
def test_whoever_asks_is_asked_although_the_settings_have_a_device(tmp_path: Path) -> None:
    settings = tmp_path / "config" / "settings.toml"
    settings.parent.mkdir()
    settings.write_text('[[device]]\nsensor = "zephyr"\nunit = "B1"\nport = "/dev/no-such-port"\n')
    with at_terminal([*_plain(), "run", "--ask"], environment(tmp_path)) as terminal:
        terminal.until_seen("Stream what the settings name: Zephyr BioHarness 3 B1")
        answer(terminal, MENU, "")
        terminal.until(lambda seen: re.search(r"^Zephyr BioHarness 3 +looking", seen, re.M))
        terminal.type("\x03")
        assert terminal.exit_code() == 0


@pytest.mark.nightly
def test_settings_that_are_wrong_are_said_and_nobody_is_asked(tmp_path: Path) -> None:
    settings = tmp_path / "config" / "settings.toml"
    settings.parent.mkdir()
    settings.write_text("[[device]]\nsensor = 1\n")
    with at_terminal([*_plain(), "run"], environment(tmp_path)) as terminal:
        assert terminal.exit_code() == 2
    assert str(settings) in terminal.screen.text.replace("\n", "")
    assert MENU not in terminal.screen.text


def _plain() -> list[str]:
    return [sys.executable, "-m", "biosensor_gateway.cli"]


FOUND = Found("polar_h10", "Polar H10 A1B2C3D4", {"unit": "A1B2C3D4", "device": "A1B2C3D4"})


def add(path: Path) -> None:
    add_device(path, settings_models(), FOUND.sensor, FOUND.settings)


def test_a_device_is_added_and_what_stands_there_stays(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_bytes(b'# mine\r\n[lsl]\r\nsession_id = "lab"')
    path.chmod(0o600)
    add(path)
    assert path.read_bytes().startswith(b'# mine\r\n[lsl]\r\nsession_id = "lab"\n')
    assert path.stat().st_mode & 0o777 == 0o600
    loaded = load_settings(path, settings_models())
    assert loaded.lsl.session_id == "lab"
    assert [each.unit for each in loaded.devices] == ["A1B2C3D4"]


@pytest.mark.parametrize("before", ["device = []\n", "[lsl]\nsesion_id = 1\n", "[[device"])
def test_a_file_that_would_be_wrong_stays_as_it_is(tmp_path: Path, before: str) -> None:
    path = tmp_path / "settings.toml"
    path.write_text(before)
    with pytest.raises(ConfigError) as caught:
        add(path)
    assert str(path) in str(caught.value)
    assert path.read_text() == before


def test_a_second_time_the_same_device_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "new" / "settings.toml"
    add(path)
    with pytest.raises(ConfigError, match="a second polar_h10") as caught:
        add(path)
    assert caught.value.reason is ConfigReason.WRONG_VALUE
    assert len(tomllib.loads(path.read_text())["device"]) == 1


# ``biosensor-gateway try``: what its recording must have, and how it begins and ends.
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


def test_who_tries_it_beside_somebody_else_is_told_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.xdf"
    stamps = [1000 + k / 10 for k in range(300)]
    file.write_bytes(x.xdf(*x.regular(1, "a", stamps, 10.0), *x.regular(2, "a", stamps, 10.0)))
    print_verdict(check(file, by_name(["a"])))
    said = " ".join(capsys.readouterr().out.split())
    assert "Somebody else in this network tries it at the same time" in said
    assert "set the environment variable BIOSENSOR_GATEWAY_LSL__SESSION_ID to a word" in said


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
    assert "Ended before everything was shown." in rest
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


# Alone: on a busy computer reports are late, and that is rightly amber.
@pytest.mark.nightly
@pytest.mark.alone
def test_a_recording_of_all_virtual_sensors_is_green(tmp_path: Path) -> None:
    process = _start(tmp_path, "--all", "--seconds", "12", "--folder", "kept")
    said, _ = process.communicate(timeout=170)
    (recording,) = (tmp_path / "kept").glob("*.xdf")
    verdict = check(recording)
    assert verdict.colour is Colour.GREEN, [each.text for each in verdict.findings]
    assert process.returncode in (0, 3), said


def _remaining(session: int) -> list[str]:
    listed = subprocess.run(
        ["ps", "-o", "args=", "-s", str(session)], capture_output=True, text=True, check=False
    )
    return listed.stdout.splitlines()


@pytest.mark.parametrize(("name", "why"), [("file", "it is not a folder"), ("file/x", "Not a dir")])
def test_a_folder_for_a_try_out_that_cannot_be_is_said_before_anything_is_started(
    tmp_path: Path, name: str, why: str
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=f"{why}.*choose another --folder"):
        Trial(tmp_path / name, None, opens=False).run(every=False)


def test_a_try_out_needs_the_loopback_interface(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreachable(*_: object) -> None:
        raise OSError(errno.ENETUNREACH, "Network is unreachable")

    monkeypatch.setattr(socket, "create_connection", unreachable)
    with pytest.raises(TransportError, match=r"Network is unreachable.*ip link set lo up"):
        Trial(tmp_path, None, opens=False).run(every=False)


def test_a_status_that_is_late_on_a_busy_computer_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = ConfigError(ConfigReason.UNREADABLE, "has not written its status for 6 s")
    gone = ConfigError(ConfigReason.NOT_FOUND, "no agent is running")
    answers: list[ConfigError | dict[str, Any]] = [late, late, {"devices": []}, late, gone]
    looks = 0

    def status(_folder: Path) -> dict[str, Any]:
        answer = answers.pop(0)
        if isinstance(answer, ConfigError):
            raise answer
        return answer

    def look() -> None:
        nonlocal looks
        looks += 1

    def at_once(_seconds: float) -> None:
        pass

    monkeypatch.setattr(trial, "running_status", status)
    monkeypatch.setattr(trial.time, "sleep", at_once)
    assert late_status(tmp_path, look) == {"devices": []}
    assert looks == 2
    with pytest.raises(ConfigError, match="no agent is running"):
        late_status(tmp_path, look)


def test_a_folder_for_a_try_out_is_only_looked_at_before(tmp_path: Path) -> None:
    require_writable(tmp_path / "new" / "one")
    assert not list(tmp_path.iterdir())
