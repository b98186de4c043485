"""``biosensor-gateway mark``: a real agent, a real inlet, and the control channel beside it."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pylsl
import pytest

from biosensor_common import naming
from biosensor_common.errors import GatewayError, ProtocolError, ProtocolReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import control
from biosensor_gateway.cli import mark
from biosensor_gateway.system.logs import LOG_FILE_NAME

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

DEADLINE_S = 30.0
SOURCE = naming.source_id(DeviceIdentity("gateway", socket.gethostname()), "markers")
NO_AGENT = "biosensor-gateway: no agent is running; start one with: biosensor-gateway run\n"

OpenInlet = Callable[[str], pylsl.StreamInlet]
Until = Callable[[Callable[[], bool]], None]
StartCli = Callable[..., AbstractContextManager["subprocess.Popen[bytes]"]]
Run = Callable[..., "Outcome"]


def command(folder: Path, *arguments: str, columns: int = 80) -> tuple[int, str, str]:
    ended = subprocess.run(
        [sys.executable, "-m", "biosensor_gateway.cli", *arguments],
        env=os.environ | {"BIOSENSOR_GATEWAY_STATE": str(folder), "COLUMNS": str(columns)},
        capture_output=True,
        text=True,
        check=False,
    )
    return ended.returncode, ended.stdout, ended.stderr


@pytest.fixture
def agent(
    cli_process: StartCli, until: Until, tmp_path: Path
) -> Generator[subprocess.Popen[bytes]]:
    """An agent without devices; they have no part in it."""
    (tmp_path / "settings.toml").write_text('[markers]\nbuttons = ["baseline", "task"]\n')
    arguments = ("run", "--settings", str(tmp_path / "settings.toml"), "--no-ask")

    def answers() -> bool:
        with suppress(GatewayError):
            return bool(control.ask(tmp_path, "markers"))
        return False

    with cli_process(tmp_path, *arguments) as process:
        until(answers)
        yield process


@pytest.mark.seam
def test_what_is_marked_undone_and_listed(
    agent: subprocess.Popen[bytes], inlet: OpenInlet, until: Until, tmp_path: Path
) -> None:
    reader = inlet(SOURCE)
    heard: list[dict[str, Any]] = []

    def has(count: int) -> bool:
        heard.extend(json.loads(row[0]) for row in reader.pull_chunk(timeout=0.0)[0])
        return len(heard) >= count

    until(lambda: has(1))
    assert [each["kind"] for each in heard] == ["ready"]
    at = pylsl.local_clock()
    pressed = {"marker": "baseline", "note": "", "kind": "button", "source": "page", "at": at}
    assert control.ask(tmp_path, "mark", pressed) == {"id": 2, "lsl_time": round(at, 6)}
    assert command(tmp_path, "mark", "task") == (0, "marker 3 was sent\n", "")
    assert command(tmp_path, "mark", "she moved", "--note") == (0, "marker 4 was sent\n", "")
    assert command(tmp_path, "mark", "--undo") == (0, "marker 4 is undone\n", "")
    assert control.ask(tmp_path, "undo-marker", {"id": 2}) == {"id": 6, "of": 2}
    assert command(tmp_path, "mark", "--undo", "2") == (
        1,
        "",
        (
            "biosensor-gateway: the agent refused undo-marker: "
            "marker 2 (baseline) is undone already\n"
        ),
    )
    code, out, err = command(tmp_path, "mark", "--list")
    assert (code, err) == (0, "")
    rows = [" ".join(line.split()) for line in out.splitlines()]
    assert [row.partition(" ago ")[2] for row in rows[:3]] == [
        "baseline (undone)",
        "task",
        "note: she moved (undone)",
    ]
    assert [row.split()[0] for row in rows[:3]] == ["2", "3", "4"]
    assert all(0 <= float(row.split()[1]) < 60 for row in rows[:3])
    assert rows[3] == "buttons: 1 baseline, 2 task"
    until(lambda: has(6))
    assert [(each["id"], each["marker"], each["kind"]) for each in heard[1:]] == [
        (2, "baseline", "button"),
        (3, "task", "api"),
        (4, "note", "note"),
        (5, "undo", "undo"),
        (6, "undo", "undo"),
    ]
    assert (heard[3]["note"], heard[3]["source"], heard[4]["of"]) == ("she moved", "command", 4)
    counted = pylsl.resolve_byprop("source_id", SOURCE.replace("markers", "counters"), timeout=10)
    counters = pylsl.StreamInlet(counted[0])
    until(lambda: json.loads(counters.pull_sample()[0][0])[SOURCE]["pushed"] == len(heard))
    agent.send_signal(signal.SIGTERM)
    assert agent.wait(DEADLINE_S) == 0
    entries = [json.loads(line) for line in (tmp_path / LOG_FILE_NAME).read_text().splitlines()]
    # Who shows the markers asks for them all the time.
    told = {each["command"] for each in entries if each["event"] == "a command came"}
    assert told == {"mark", "undo-marker"}
    assert "she moved" not in (tmp_path / LOG_FILE_NAME).read_text()


@pytest.mark.nightly
@pytest.mark.usefixtures("agent")
def test_other_buttons_hold_after_a_reload(tmp_path: Path) -> None:
    assert control.ask(tmp_path, "markers") == {"markers": [], "buttons": ["baseline", "task"]}
    (tmp_path / "settings.toml").write_text('[markers]\nbuttons = ["rest"]\n')
    assert command(tmp_path, "reload") == (
        0,
        "nothing has changed for any device\nwhat was changed in [markers] holds now\n",
        "",
    )
    assert control.ask(tmp_path, "markers")["buttons"] == ["rest"]
    assert command(tmp_path, "reload")[1] == "nothing has changed for any device\n"
    (tmp_path / "settings.toml").write_text('[markers]\nbuttons = ["rest", "rest"]\n')
    assert "no name twice" in command(tmp_path, "reload")[2]
    assert control.ask(tmp_path, "markers")["buttons"] == ["rest"]


@pytest.mark.nightly
@pytest.mark.usefixtures("agent")
def test_two_long_texts_fit_into_a_request_and_a_list(tmp_path: Path) -> None:
    # Twelve bytes a letter, as JSON has them.
    longest = "\U0001f600" * 200
    for number in range(1, 11):
        sent = {"marker": longest, "note": longest, "source": "\U0001f600" * 32}
        assert control.ask(tmp_path, "mark", sent)["id"] == number
    listed = control.ask(tmp_path, "markers")["markers"]
    assert [each["note"] for each in listed] == [longest] * 10
    with pytest.raises(ProtocolError, match="printable text up to 200 letters") as caught:
        control.ask(tmp_path, "mark", {"marker": f"{longest}!"})
    assert caught.value.reason is ProtocolReason.REFUSED


@pytest.mark.parametrize(
    "wrong",
    [
        (),
        ("",),
        ("--note",),
        ("text", "--list"),
        ("--undo", "--list"),
        ("text", "--note", "--undo"),
        ("seven", "--undo"),
    ],
)
def test_a_wrong_command_is_a_usage_error(run: Run, wrong: tuple[str, ...]) -> None:
    outcome = run("mark", *wrong)
    assert (outcome.code, outcome.out) == (2, "")


def test_without_an_agent_it_says_so(run: Run) -> None:
    for arguments in (("text",), ("--undo",), ("--list",)):
        assert run("mark", *arguments) == (1, "", NO_AGENT)


def test_marked_is_when_the_command_was_given(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, Any]] = []

    def ask(_folder: Path, name: str, arguments: dict[str, Any]) -> dict[str, Any]:
        asked.append({"command": name, **arguments})
        return {"id": 1, "lsl_time": arguments["at"]}

    begun_s = time.perf_counter() - 7.0
    given_s = pylsl.local_clock() - 7.0
    monkeypatch.setattr(mark, "BEGUN_S", begun_s)
    monkeypatch.setattr(control, "ask", ask)
    assert run("mark", "task") == (0, "marker 1 was sent\n", "")
    (sent,) = asked
    # Both clocks count the same seconds, however long the command has taken.
    assert sent.pop("at") == pytest.approx(given_s, abs=0.1)
    assert sent == {"command": "mark", "marker": "task", "kind": "api", "source": "command"}


def test_a_marker_that_nobody_receives_is_said(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    sent = {"id": 1, "marker": "task", "note": "", "kind": "api", "lsl_time": 0.0, "undone": False}
    lost = {**sent, "received": False}

    def ask(_folder: Path, name: str, _arguments: object = None) -> dict[str, Any]:
        return lost if name == "mark" else {"markers": [lost, {**sent, "id": 2}], "buttons": []}

    monkeypatch.setattr(control, "ask", ask)
    assert run("mark", "task") == (0, "marker 1 was sent, but no program receives it\n", "")
    first, second = run("mark", "--list")[1].splitlines()
    assert first.endswith("task, received by nobody")
    assert second.endswith("task")


def test_a_list_fits_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def eighty(_output: object) -> int:
        return 80

    monkeypatch.setattr(mark, "columns", eighty)
    text = "word " * 40
    marker = {"id": 12345, "marker": text, "note": text, "lsl_time": 0.0, "undone": True}
    marker |= {"kind": "web", "source": "https://a-study.example.org:8443"}
    names = [f"a button with a long name, no. {number:2}" for number in range(20)]
    mark._print_list({"markers": [marker], "buttons": names})  # pyright: ignore[reportPrivateUsage]
    shown = capsys.readouterr().out
    assert all(len(line) <= 80 for line in shown.splitlines())
    assert shown.count("word") == 80
    assert "9 a button with a long name, no. 8," in " ".join(shown.split())
    assert "10 a button" not in shown
