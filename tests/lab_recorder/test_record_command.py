"""``record`` beside a running agent, with a LabRecorder that really records."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, cast

import pylsl
import pytest
import pyxdf

from biosensor_gateway.devices.registry import declaration
from tests.lab_recorder.conftest import CommandLine, Outcome
from tests.lab_recorder.remote_control import LabRecorderPeer

pytestmark = pytest.mark.nightly

Record = Callable[..., Outcome]

OURS = {f"zephyr-virtual-{stream.data_name}" for stream in declaration("zephyr").streams}
FOREIGN = "mouse-of-another-program"

_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


def sentence(outcome: Outcome, code: int = 1) -> str:
    assert (outcome.code, outcome.out) == (code, ""), outcome
    assert outcome.err.startswith("biosensor-gateway: ")
    assert outcome.err.count("\n") == 1
    return outcome.err


def recorded_ids(path: Path) -> set[str]:
    streams, _ = _load_xdf(str(path))
    return {stream["info"]["source_id"][0] for stream in streams}


@pytest.fixture
def foreign() -> Generator[pylsl.StreamOutlet]:
    info = pylsl.StreamInfo("Mouse", "Position", 2, 0, "float32", FOREIGN)
    outlet = pylsl.StreamOutlet(info)
    yield outlet
    del outlet


@pytest.mark.nightly
def test_it_records_until_it_is_stopped(record: Record, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    begun = record("start", "--folder", str(folder), "--participant", "P07", "--task", "Walk",
                   "--run", "3", "--modality", "EEG", "--json")  # fmt: skip
    assert begun.code == 0, begun.err
    name = "sub-P07/ses-S001/eeg/sub-P07_ses-S001_task-Walk_run-003_eeg.xdf"
    file = folder / name
    started = begun.json
    assert (started["verified"], started["file"]) == (True, str(file))
    assert started["foreign"] == started["warnings"] == []
    assert {stream["source_id"] for stream in started["streams"]} >= OURS
    assert 0 < started["bytes"] <= file.stat().st_size

    assert "already recording" in sentence(record("start", "--folder", str(folder)))
    during = record("status", "--json")
    assert during.code == 0
    assert (during.json["recording"], during.json["file"]) == (True, str(file))

    ended = record("stop", "--host", "localhost", "--json")
    assert ended.code == 0, ended.err
    assert (ended.json["verified"], ended.json["file"]) == (True, str(file))
    assert ended.json["bytes"] == file.stat().st_size
    assert ended.json["streams"] == len(recorded_ids(file))
    assert recorded_ids(file) >= OURS
    after = record("status", "--file", str(file), "--json").json
    assert (after["recording"], after["is_closed"]) == (False, True)

    torn = tmp_path / "torn.xdf"
    torn.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert "xdf check" in sentence(record("stop", "--file", str(torn)))


def test_a_file_of_any_name_is_written_in_lower_case(record: Record, tmp_path: Path) -> None:
    begun = record("start", "--file", str(tmp_path / "Night One.xdf"))
    assert begun.code == 0, begun.err
    assert str(tmp_path / "night one.xdf") in begun.out
    ended = record("stop")
    assert ended.code == 0
    assert "is closed" in ended.out
    again = sentence(record("start", "--file", str(tmp_path / "Night One.xdf")))
    assert "already exists" in again
    assert [path.name for path in tmp_path.glob("*.xdf")] == ["night one.xdf"]


@pytest.mark.usefixtures("foreign")
def test_labrecorder_may_choose_the_name_in_a_folder(record: Record, tmp_path: Path) -> None:
    folder = tmp_path / "chosen"
    begun = record("start", "--folder", str(folder), "--all", "--json")
    assert begun.code == 0, begun.err
    (file,) = folder.rglob("*.xdf")
    assert begun.json["file"] == str(file)
    # They are wanted, so that they are there is no warning.
    assert [stream["source_id"] for stream in begun.json["foreign"]] == [FOREIGN]
    assert begun.json["warnings"] == []
    assert record("stop", "--json").json["file"] == str(file)


def test_an_ok_without_a_file_is_no_start(agent: CommandLine, tmp_path: Path) -> None:
    with LabRecorderPeer(tmp_path, deaf=True) as recorder:
        port = str(recorder.port)
        begun = agent("record", "start", "--port", port, "--file", str(tmp_path / "a.xdf"),
                      "--timeout", "3")  # fmt: skip
        assert recorder.lines[-1] == "start"
        assert "did not appear and grow within 3 s" in sentence(begun)
        assert "nothing was recorded" in sentence(agent("record", "stop", "--port", port))


def test_what_was_started_in_the_window_is_not_taken_for_ours(
    record: Record, recorder: LabRecorderPeer, tmp_path: Path
) -> None:
    recorder.click_start()
    (by_hand,) = recorder.files
    begun = record("start", "--file", str(tmp_path / "ours.xdf"), "--timeout", "3")
    assert "already be recording something else" in sentence(begun)
    ended = record("stop", "--file", str(by_hand), "--json")
    assert (ended.code, ended.json["verified"]) == (0, True)


def test_a_stop_without_a_known_file_says_that_nothing_was_verified(record: Record) -> None:
    ended = record("stop")
    assert ended.code == 0
    assert "not verified" in ended.out
    assert "--file" in ended.err
    known = record("status", "--json")
    assert (known.code, known.json["recording"], known.json["is_local"]) == (0, None, True)


@pytest.mark.usefixtures("foreign")
def test_streams_of_others_are_named_because_they_are_recorded_too(
    record: Record, recorder: LabRecorderPeer, tmp_path: Path
) -> None:
    refused = sentence(record("start", "--file", str(tmp_path / "a.xdf"), "--only-ours"))
    assert f"Mouse ({socket.gethostname()})" in refused
    assert "start" not in recorder.lines

    warned = record("start", "--file", str(tmp_path / "a.xdf"))
    assert warned.code == 0
    assert warned.err.startswith("! ")
    assert f"Mouse ({socket.gethostname()})" in warned.err
    assert record("stop").code == 0
    assert FOREIGN in recorded_ids(tmp_path / "a.xdf")


def test_without_a_labrecorder_it_says_so(agent: CommandLine, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = str(server.getsockname()[1])
    for command in (("start", "--file", str(tmp_path / "a.xdf")), ("stop",)):
        assert "EnableRCS" in sentence(agent("record", *command, "--port", port))
    known = agent("record", "status", "--port", port, "--json")
    assert (known.code, known.json["answers"]) == (1, False)
    assert "EnableRCS" in known.json["problems"][0]["text"]


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("--file", "a.txt"),
        ("--folder", "x", "--participant", "Jane Doe"),
        ("--folder", "x", "--task", "Walk"),
        ("--folder", "x", "--all", "--only-ours"),
    ],
)
def test_a_wrong_command_is_a_usage_error(
    record: Record, recorder: LabRecorderPeer, arguments: tuple[str, ...]
) -> None:
    outcome = record("start", *arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert "start" not in recorder.lines


DEVICES = """
[[device]]
sensor = "zephyr"
unit = "absent"
port = "/dev/none"
participant = "p01"
"""


def test_missing_streams_are_named_and_can_be_done_without(
    recorder: LabRecorderPeer, tmp_path: Path
) -> None:
    command_line = CommandLine(tmp_path / "state")
    settings = tmp_path / "settings.toml"
    settings.write_text(DEVICES)
    info = pylsl.StreamInfo("p01-zephyr-absent-hr", "HR", 1, 10, "float32", "p01@zephyr-hr")
    outlet = pylsl.StreamOutlet(info)
    start = ("record", "start", "--port", str(recorder.port), "--settings", str(settings),
             "--file", str(tmp_path / "a.xdf"))  # fmt: skip
    refused = sentence(command_line(*start))
    assert "p01 zephyr (absent), only 1 of its 13 streams: no agent is running here" in refused
    assert "wait-ready" in refused
    assert "start" not in recorder.lines

    process = command_line.begin(*start, "--allow-missing", "--timeout", "60")
    while process.poll() is None:
        # As much as fills the blocks that a recorder writes.
        outlet.push_chunk([[1.0]] * 1000)
        time.sleep(0.05)
    _, err = process.communicate()
    assert process.returncode == 0, err
    assert "recorded without: p01 zephyr (absent)" in err
    assert command_line("record", "stop", "--port", str(recorder.port)).code == 0
