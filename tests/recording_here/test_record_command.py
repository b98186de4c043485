"""``record`` where no window of LabRecorder is open."""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.lab_recorder.conftest import CommandLine, Outcome
from tests.recording_here.conftest import Sources
from tests.rigs.lsl_streams import wait_until

pytestmark = pytest.mark.nightly

Record = Callable[..., Outcome]


@pytest.fixture
def record(state: Path) -> Record:
    """``record`` beside no agent; what a test leaves running is ended with `state`."""
    command_line = CommandLine(state)

    def run(command: str, *arguments: str) -> Outcome:
        return command_line("record", command, *arguments)

    return run


@pytest.mark.seam
def test_it_records_until_it_is_stopped(
    record: Record, sources: Sources, state: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "OneDrive"
    folder.mkdir()
    start = ("start", "--here", "--folder", str(folder), "--participant", "P07")
    begun = record(*start, "--json")
    assert begun.code == 0, begun.err
    file = begun.json["file"]
    # It has made the state folder, into which nobody else looks.
    assert state.stat().st_mode & 0o077 == 0
    assert (begun.json["by"], Path(file).parents[3]) == ("gateway", folder)
    # Nobody's agent has them, and they are recorded all the same.
    assert {each["name"] for each in begun.json["foreign"]} == {"chest", "wrist"}
    assert "--only-ours" in begun.json["warnings"][0]
    assert begun.json["warnings"][-1].startswith("OneDrive copies")

    again = record(*start)
    assert again.code == 1
    assert f"recording already, to {file}" in again.err
    wait_until(lambda: _samples(record("status", "--json")) > 0, "it grows")
    during = record("status")
    assert during.code == 0, during
    assert f"recording to {file}" in during.out
    assert "chest" in during.out

    ended = record("stop")
    assert ended.code == 0, ended.err
    assert f"{file} is closed" in ended.out
    assert ended.out.splitlines()[-1].split(":")[0] in {"green", "amber"}
    del sources


def test_where_no_folder_is_named_it_is_that_of_the_page(
    state: Path, sources: Sources, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Where Linux keeps documents, and where Windows and macOS do without being asked.
    (tmp_path / "Documents").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_DOCUMENTS_DIR", str(tmp_path / "Documents"))
    command_line = CommandLine(state)
    begun = command_line("record", "start", "--here", "--participant", "P07", "--json")
    assert begun.code == 0, begun.err
    assert command_line("record", "stop").code == 0
    folder = tmp_path / "Documents" / "Biosensor recordings"
    assert Path(begun.json["file"]).is_relative_to(folder)
    del sources


def test_virtual_devices_are_recorded_in_the_session_of_the_settings(
    state: Path, record: Record, tmp_path: Path
) -> None:
    """What streams in another session than `record` looks in would not be there for it."""
    command_line = CommandLine(state)
    state.mkdir()
    (state / "none.toml").write_text(f'[lsl]\nsession_id = "{uuid.uuid4().hex}"\n')
    agent = command_line.begin("run", "--no-ask", "--simulate", "zephyr")
    try:
        ready = command_line("wait-ready", "--timeout", "60")
        assert ready.code == 0, ready.err
        begun = record("start", "--here", "--folder", str(tmp_path), "--participant", "P07")
        assert begun.code == 0, begun.err
        assert record("stop").code == 0
    finally:
        agent.terminate()
        agent.communicate(timeout=60)


@pytest.mark.parametrize("command", ["stop", "status"])
def test_there_is_nothing_to_stop_or_to_look_at(record: Record, command: str) -> None:
    outcome = record(command)
    assert outcome.code == 1
    assert "nothing is being recorded here" in outcome.err


def _samples(status: Outcome) -> int:
    assert status.code == 0, status
    return sum(each["samples"] for each in status.json["sight"]["streams"])


@pytest.mark.usefixtures("sources")
def test_it_is_watched_until_it_ends(state: Path, record: Record, tmp_path: Path) -> None:
    file = tmp_path / "Night One.xdf"
    assert record("start", "--here", "--file", str(file), "--all").code == 0
    watching = CommandLine(state).watch("record", "status", "--watch", "--json")
    with watching:
        assert watching.stdout is not None
        assert json.loads(watching.stdout.readline())["file"] == str(file)
        assert record("stop", "--file", str(file)).code == 0
        lines = watching.stdout.read().splitlines()
    assert all(json.loads(line)["file"] == str(file) for line in lines)
    assert watching.returncode == 0


@pytest.mark.parametrize(
    "arguments",
    [
        ("--here", "--file", "a.txt"),
        ("--here", "--folder", "x", "--participant", "Jane Doe"),
        ("--here", "--window", "--folder", "x"),
        ("--here", "--host", "lab-pc", "--folder", "x"),
    ],
)
def test_a_wrong_command_is_a_usage_error(record: Record, arguments: tuple[str, ...]) -> None:
    outcome = record("start", *arguments)
    assert (outcome.code, outcome.out) == (2, "")


def test_only_what_this_agent_has_is_refused_without_an_agent(
    record: Record, sources: Sources, tmp_path: Path
) -> None:
    refused = record("start", "--here", "--folder", str(tmp_path / "x"), "--only-ours")
    assert refused.code == 1
    assert "no LSL stream of this agent" in refused.err
    assert not (tmp_path / "x").exists()
    del sources


def test_a_window_in_any_case_is_a_window(record: Record, tmp_path: Path) -> None:
    refused = record("start", "--window", "--port", "1", "--folder", str(tmp_path))
    assert refused.code == 1
    assert "EnableRCS" in refused.err
