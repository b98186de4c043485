"""``biosensor-gateway capture``: nothing is saved of which nobody has seen what it holds."""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.captures import recorder
from biosensor_gateway.captures.draft import AGREED, Draft
from biosensor_gateway.captures.file import ENDING, Capture, packed, read
from biosensor_gateway.captures.recorder import Taken
from biosensor_gateway.captures.redaction import Replaced
from biosensor_gateway.captures.replay import replay
from biosensor_gateway.cli import capture as command
from biosensor_gateway.cli.app import app
from biosensor_gateway.doctor import device_test
from biosensor_gateway.doctor.device_test import DeviceTest
from biosensor_gateway.settings.models import DeviceSettings
from tests.rigs.kept_logging import kept_logging
from tests.zephyr import recorded_capture

LIMIT_S = 120.0
SECRET = "00:07:80:5A:3E:7E"
Command = Callable[..., int]


@pytest.fixture(autouse=True)
def restore_logging() -> Iterator[None]:
    with kept_logging():
        yield


@pytest.fixture
def device() -> Capture:
    """The first reads of a real device."""
    whole = recorded_capture.capture()
    return whole.model_copy(update={"events": whole.events[:200]})


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch, device: Capture, tmp_path: Path) -> list[str]:
    """What a person types, the last first; the device is there."""
    answers: list[str] = []
    replaced = [Replaced("address", SECRET, "00:17:81:5B:3F:7F", 3)]

    async def take(settings: DeviceSettings, seconds: float) -> Taken:
        assert (settings.sensor, seconds) == ("zephyr", 5.0)
        return Taken(device, replaced, DeviceTest(problems=["hr: no sample arrived"]))

    def answer(_question: str) -> str:
        return answers.pop()

    monkeypatch.setattr(recorder, "take", take)
    monkeypatch.setattr(command, "can_ask", lambda: True)
    monkeypatch.setattr("builtins.input", answer)
    monkeypatch.chdir(tmp_path)
    settings = tmp_path / "settings.toml"
    settings.write_text(f'[[device]]\nsensor = "zephyr"\nunit = "U1"\nport = "{SECRET}"\n')
    return answers


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Command:
    """Run a command; return its exit code."""

    def run(*arguments: str) -> int:
        monkeypatch.setattr(sys, "argv", ["biosensor-gateway", *arguments])
        with pytest.raises(SystemExit) as ended:
            app()()
        return int(ended.value.code or 0)

    return run


CAPTURE = ("capture", "zephyr", "--settings", "settings.toml", "--seconds", "5")


def test_who_agrees_gets_a_file_with_consent_and_note(
    typed: list[str], run: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    typed[:] = ["stops after a minute", "yes"]
    assert run(*CAPTURE) == 0
    (file,) = tmp_path.glob(f"*{ENDING}")
    assert file.name.startswith("zephyr-BioHarness_3-")
    header = read(file).header
    assert header.consent == AGREED
    assert header.note == "stops after a minute"
    told = capsys.readouterr().out
    # What leaves, what was replaced, and what that means, before the question.
    assert f"{SECRET} became" in told
    assert "fingerprint" in told
    assert "hr: no sample arrived" in told
    assert "Nothing was sent" in told


@pytest.mark.parametrize(
    ("secret", "told"),
    [("A1B2C3D4", "for each of them: none is left"), ("42", "Shorter ones were replaced only")],
)
def test_what_was_not_searched_for_is_not_said_to_be(
    device: Capture, secret: str, told: str
) -> None:
    replaced = [Replaced("serial number", secret, secret[::-1], 1)]
    assert told in Draft(Taken(device, replaced, DeviceTest())).lines[-1]


def test_a_place_that_cannot_be_is_told_before_the_device_is_worn(
    typed: list[str], run: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "there").write_bytes(b"theirs")
    for place, why in (("there", "already exists"), ("no/folder", "there is no folder no")):
        typed[:] = ["yes"]
        with pytest.raises(ConfigError, match=why):
            app()([*CAPTURE, "--output", place], standalone_mode=False)
        assert typed == ["yes"]
    assert "Connecting" not in capsys.readouterr().out


def test_what_cannot_be_saved_here_is_saved_elsewhere(
    typed: list[str], run: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The folder is gone when it is saved.
    (tmp_path / "stick").mkdir()
    (tmp_path / "disk").mkdir()

    def answer(question: str) -> str:
        if question.startswith("Type yes"):
            (tmp_path / "stick").rmdir()
        return typed.pop()

    monkeypatch.setattr("builtins.input", answer)
    typed[:] = ["disk", "as usual", "yes"]
    assert run(*CAPTURE, "--output", "stick/mine.capture.gz") == 0
    (file,) = (tmp_path / "disk").iterdir()
    assert read(file).header.note == "as usual"
    (tmp_path / "stick").mkdir()
    typed[:] = ["", "", "yes"]
    assert run(*CAPTURE, "--output", "stick/mine.capture.gz") == 1


def test_a_full_disk_leaves_no_half_of_a_file(
    device: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / f"mine{ENDING}"
    opened = Path.open

    def full(path: Path, mode: str) -> Any:
        with opened(path, mode) as made:
            made.write(b"half")
        return opened(Path("/dev/full"), "wb", 0)

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(ConfigError, match="No space left on device"):
        Draft(Taken(device, [], DeviceTest())).save(file)
    assert not file.exists()


def test_a_note_names_nothing_that_was_replaced(device: Capture, tmp_path: Path) -> None:
    replaced = [Replaced("serial number", "A1B2C3D4", "A7F0C2E4", 1)]
    draft = Draft(Taken(device, replaced, DeviceTest()))
    file = draft.save(tmp_path, "a1b2c3d4 (A1B2C3D4) stops")
    assert read(file).header.note == "A7F0C2E4 (A7F0C2E4) stops"


def test_who_interrupts_is_told_that_nothing_was_saved(
    typed: list[str],
    run: Command,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def interrupted(_question: str) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("builtins.input", interrupted)
    monkeypatch.setattr(sys, "argv", ["biosensor-gateway", *CAPTURE])
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        app()()
    assert "Nothing was saved." in capsys.readouterr().out


@pytest.mark.parametrize("command", [CAPTURE, ("test", "zephyr", "--settings", "settings.toml")])
@pytest.mark.parametrize(
    ("state", "is_virtual", "is_refused"),
    [(State.STREAMING, False, True), (State.STREAMING, True, False), (State.BACKOFF, False, False)],
)
def test_a_device_that_the_agent_streams_is_not_taken_from_it(
    typed: list[str],
    monkeypatch: pytest.MonkeyPatch,
    command: tuple[str, ...],
    state: State,
    is_virtual: bool,
    is_refused: bool,
) -> None:
    own = {"sensor": "zephyr", "unit": "U1", "state": state.value}

    def status(_folder: Path) -> dict[str, Any]:
        return {"devices": [own], "virtual": is_virtual}

    async def no_test(*_: object) -> DeviceTest:
        return DeviceTest()

    monkeypatch.setattr(status_file, "running_status", status)
    monkeypatch.setattr(device_test, "run_device_test", no_test)
    typed[:] = ["no"]
    told = ""
    try:
        app()([*command], standalone_mode=False)
    except ConfigError as error:
        told = str(error)
    assert ("the agent is using zephyr U1" in told) == is_refused


def test_no_saves_nothing(typed: list[str], run: Command, tmp_path: Path) -> None:
    typed[:] = ["no"]
    assert run(*CAPTURE) == 1
    assert not list(tmp_path.glob(f"*{ENDING}"))


@pytest.mark.parametrize("answer", ["", "y", "yes please", "noo"])
@pytest.mark.parametrize(("then", "saved"), [(["no"], 0), (["fine", "yes"], 1)])
def test_what_is_mistyped_neither_saves_nor_throws_away(
    typed: list[str], run: Command, tmp_path: Path, answer: str, then: list[str], saved: int
) -> None:
    typed[:] = [*then, answer]
    assert run(*CAPTURE) == 1 - saved
    assert len(list(tmp_path.glob(f"*{ENDING}"))) == saved
    assert typed == []


def test_all_of_it_is_shown_to_who_asks(
    typed: list[str], run: Command, device: Capture, capsys: pytest.CaptureFixture[str]
) -> None:
    typed[:] = ["no", "show"]
    assert run(*CAPTURE) == 1
    told = capsys.readouterr().out
    assert all(each.data in told for each in device.events)


def test_a_program_cannot_consent(
    typed: list[str], run: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "can_ask", lambda: False)
    monkeypatch.setattr(sys, "argv", ["biosensor-gateway", *CAPTURE])
    with pytest.raises(ConfigError, match="a person's consent"):
        app()(standalone_mode=False)


def test_a_replay_reports_each_stream(
    run: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = recorded_capture.capture()
    short = whole.model_copy(update={"events": whole.events[:400]})
    (tmp_path / f"one{ENDING}").write_bytes(packed(short))
    assert run("capture", "replay", str(tmp_path), "--json") == 0
    (report,) = json.loads(capsys.readouterr().out).values()
    assert report["problems"] == []
    ecg = report["streams"]["ecg"]
    assert (ecg["samples"] % 63, ecg["lost"], ecg["refused"]) == (0, 0, 0)
    assert ecg["samples"] > 1000
    assert ecg["least_s"] <= ecg["median_s"] <= ecg["most_s"]


@pytest.mark.parametrize(
    ("header", "events", "why"),
    [
        ({"sensor": "nosuch"}, 9, "There is no sensor 'nosuch'"),
        ({"settings": {"x": "y"}}, 9, "the settings of the capture are not valid"),
        ({}, 0, "the capture has a connection without a start"),
    ],
)
def test_of_several_captures_the_one_that_is_refused_is_named(
    header: dict[str, object],
    events: int,
    why: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = recorded_capture.capture()
    update = {"header": whole.header.model_copy(update=header), "events": whole.events[:events]}
    file = tmp_path / f"bad{ENDING}"
    file.write_bytes(packed(whole.model_copy(update=update)))
    monkeypatch.setattr(sys, "argv", ["biosensor-gateway", "capture", "replay", str(tmp_path)])
    with pytest.raises(ConfigError, match=f"^{file}: {why}"):
        app()(standalone_mode=False)


@pytest.mark.parametrize(
    ("sensor", "fields", "why"),
    [
        ("polar_h10", {}, "Polar H10 is not in range"),
        ("polar_broadcast", {}, "0 connections of 1"),
        # Its library is asked for what the board has.
        pytest.param(
            "brainflow",
            {"board": "SYNTHETIC_BOARD"},
            "which no capture can replace",
            marks=pytest.mark.seam,
        ),
    ],
)
def test_a_file_of_a_stranger_reaches_no_device_of_this_computer(
    device: Capture, sensor: str, fields: dict[str, str], why: str
) -> None:
    header = device.header.model_copy(update={"sensor": sensor, "settings": fields})
    report = replay(device.model_copy(update={"header": header}))
    (problem,) = (each for each in report.problems if "connections" in each)
    assert why in problem
    assert "Bluetooth is" not in problem


@pytest.mark.parametrize("field", ["t", "took"])
@pytest.mark.parametrize("time", ["NaN", "Infinity"])
def test_times_that_are_no_numbers_are_refused(
    device: Capture, tmp_path: Path, field: str, time: str
) -> None:
    lines = gzip.decompress(packed(device)).decode().splitlines()
    event = json.loads(lines[-1]) | {field: float(time)}
    file = tmp_path / f"bad{ENDING}"
    file.write_bytes(gzip.compress("\n".join([*lines, json.dumps(event)]).encode()))
    with pytest.raises(ConfigError, match="finite number"):
        read(file)


def test_a_folder_without_a_capture_is_not_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["biosensor-gateway", "capture", "replay", str(tmp_path)])
    with pytest.raises(ConfigError, match="there is no capture, no file"):
        app()(standalone_mode=False)


# Run after the command in its process: what a stream of it has.
SESSION = """
import sys
from contextlib import suppress
import pylsl
from biosensor_gateway.cli.app import app
with suppress(SystemExit):
    app()()
print(pylsl.StreamOutlet(pylsl.StreamInfo("a", "b", 1)).get_info().session_id(), file=sys.stderr)
"""


@pytest.mark.nightly
def test_a_live_replay_is_in_the_session_of_the_settings(device: Capture, tmp_path: Path) -> None:
    file, settings = tmp_path / f"a{ENDING}", tmp_path / "settings.toml"
    file.write_bytes(packed(device.model_copy(update={"events": device.events[:20]})))
    settings.write_text('[lsl]\nsession_id = "lab7"\n')
    words = ("capture", "replay", str(file), "--live", "--settings", str(settings))
    command = (sys.executable, "-c", SESSION, *words)
    done = subprocess.run(command, capture_output=True, check=True, timeout=LIMIT_S)
    assert done.stderr.decode().splitlines()[-1] == "lab7"
