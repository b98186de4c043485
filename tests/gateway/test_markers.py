"""The experimenter's markers: what a real inlet gets, what is undone, and what is refused."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncGenerator, Callable, Generator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import pylsl
import pytest
from structlog.testing import capture_logs

from biosensor_common import naming
from biosensor_common.errors import (
    ConfigError,
    ConfigReason,
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import control
from biosensor_gateway.agent.marker_commands import (
    LISTED,
    MAX_AGE_S,
    MAX_LEAD_S,
    MAX_SOURCE,
    MAX_TEXT,
    MarkerCommands,
)
from biosensor_gateway.cli import mark
from biosensor_gateway.settings.file import load_settings
from biosensor_gateway.settings.models import MarkerSettings
from biosensor_gateway.streaming import marker_stream, outlets
from biosensor_gateway.streaming.marker_stream import KEPT, MarkerStream
from biosensor_gateway.system.clock import LSL_CLOCK, Clock
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.rigs.gateway import cli_process, inlet
from tests.rigs.polling import eventually, wait_until

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

SOURCE = naming.source_id(DeviceIdentity("gateway", socket.gethostname()), "markers")
BUTTONS = ("baseline", "stimulus on")


class Desk:
    """A stream of markers, its commands, and what a receiver gets."""

    def __init__(self, clock: Clock) -> None:
        self.stream = MarkerStream(clock)
        self.commands = MarkerCommands(self.stream, MarkerSettings(buttons=BUTTONS))
        self.heard: list[tuple[dict[str, Any], float]] = []
        self._reader: pylsl.StreamInlet | None = None

    async def ask(self, command: str, **arguments: object) -> Mapping[str, Any]:
        return await self.commands.commands[command](arguments)

    async def refusal(self, command: str, **arguments: object) -> ConfigError:
        with pytest.raises(ConfigError) as caught:
            await self.ask(command, **arguments)
        return caught.value

    def listen(self, reader: pylsl.StreamInlet) -> None:
        self._reader = reader

    def stop_listening(self) -> None:
        self._reader = None

    def pull(self) -> list[dict[str, Any]]:
        assert self._reader is not None
        samples, stamps = self._reader.pull_chunk(timeout=0.0)
        self.heard += zip((json.loads(row[0]) for row in samples), stamps, strict=True)
        return [marker for marker, _ in self.heard]

    def has(self, count: int) -> Callable[[], bool]:
        return lambda: len(self.pull()) >= count


@pytest.fixture
async def desk(virtual_clock: Clock) -> AsyncGenerator[Desk]:
    running = Desk(virtual_clock)
    running.stream.open()
    yield running
    await running.stream.end()


async def listened_to(desk: Desk) -> Desk:
    desk.listen(await asyncio.to_thread(inlet, SOURCE))
    await eventually(lambda: desk.stream.is_received)
    return desk


@pytest.fixture
async def heard_desk(desk: Desk) -> Desk:
    return await listened_to(desk)


@pytest.mark.nightly
async def test_a_marker_says_all_of_itself(heard_desk: Desk) -> None:
    now = heard_desk.stream.clock()
    at = now - 2.5
    pressed = {"marker": "baseline", "note": "", "kind": "button", "source": "page", "at": at}
    assert await heard_desk.ask("mark", **pressed) == {"id": 1, "lsl_time": round(at, 6)}
    await asyncio.sleep(7.0)
    answer = await heard_desk.ask("mark", marker="", note=" she said \u201ccold\u201d ")
    assert answer["lsl_time"] == round(now + 7.0, 6)
    await heard_desk.ask("mark", marker="trigger 3")
    await eventually(heard_desk.has(3))
    button, note, sent = heard_desk.pull()
    assert button == {
        "marker": "baseline",
        "kind": "button",
        "id": 1,
        "source": "page",
        "lsl_time": round(at, 6),
    }
    assert note == {
        "marker": "note",
        "kind": "note",
        "id": 2,
        "note": "she said \u201ccold\u201d",
        "lsl_time": answer["lsl_time"],
    }
    assert (sent["marker"], sent["kind"], sent["id"]) == ("trigger 3", "api", 3)
    assert heard_desk.heard[0][1] == pytest.approx(at, abs=1e-6)


@pytest.mark.nightly
async def test_stamps_never_run_back_and_the_text_says_when_it_was(heard_desk: Desk) -> None:
    now = heard_desk.stream.clock()
    times = [now - 1.0, now - 30.0, now + 0.05, now]
    for at in times:
        await heard_desk.ask("mark", marker="m", at=at)
    await eventually(heard_desk.has(len(times)))
    stamps = [stamp for _, stamp in heard_desk.heard]
    assert stamps == sorted(set(stamps))
    assert stamps == pytest.approx([now - 1.0, now - 1.0, now + 0.05, now + 0.05], abs=1e-5)
    assert [each["lsl_time"] for each in heard_desk.pull()] == pytest.approx(times, abs=1e-6)


@pytest.mark.nightly
async def test_an_undo_marks_and_deletes_nothing(heard_desk: Desk) -> None:
    for name in ("a", "b", "c"):
        await heard_desk.ask("mark", marker=name)
    assert await heard_desk.ask("undo-marker", id=1) == {"id": 4, "of": 1}
    assert await heard_desk.ask("undo-marker") == {"id": 5, "of": 3}
    assert await heard_desk.ask("undo-marker") == {"id": 6, "of": 2}
    await eventually(heard_desk.has(6))
    undos = heard_desk.pull()[3:]
    assert [(each["marker"], each["kind"], each["of"]) for each in undos] == [
        ("undo", "undo", 1),
        ("undo", "undo", 3),
        ("undo", "undo", 2),
    ]
    nothing = await heard_desk.refusal("undo-marker")
    assert (nothing.reason, str(nothing)) == (
        ConfigReason.NOT_FOUND,
        "there is no marker to undo",
    )
    again = await heard_desk.refusal("undo-marker", id=2)
    assert again.reason is ConfigReason.WRONG_VALUE
    assert str(again) == "marker 2 (b) is already undone"
    # An undo itself, and numbers that nobody has given.
    for number in (4, 0, -1, 99):
        assert f"the id {number} " in str(await heard_desk.refusal("undo-marker", id=number))
    await heard_desk.ask("mark", marker="d")
    await eventually(heard_desk.has(7))
    assert heard_desk.pull()[-1]["id"] == 7


async def test_the_list_has_the_last_ones_and_who_is_undone(desk: Desk) -> None:
    assert await desk.ask("markers") == {"markers": [], "buttons": list(BUTTONS)}
    for number in range(LISTED + 2):
        await desk.ask("mark", marker=f"m{number}", source="page")
    await desk.ask("undo-marker", id=11)
    listed = (await desk.ask("markers"))["markers"]
    assert [each["id"] for each in listed] == list(range(3, LISTED + 3))
    assert [each["id"] for each in listed if each["undone"]] == [11]
    newest = listed[-1]
    assert set(newest) == {
        "id",
        "marker",
        "note",
        "kind",
        "source",
        "lsl_time",
        "received",
        "undone",
    }
    assert (newest["marker"], newest["kind"], newest["source"]) == (f"m{LISTED + 1}", "api", "page")
    desk.commands.settings = MarkerSettings(buttons=("other",))
    assert json.loads(json.dumps(await desk.ask("markers")))["buttons"] == ["other"]


async def test_what_is_remembered_has_an_end(desk: Desk) -> None:
    for _ in range(KEPT + 1):
        await desk.ask("mark", marker="m")
    assert (await desk.refusal("undo-marker", id=1)).reason is ConfigReason.NOT_FOUND
    assert (await desk.ask("undo-marker", id=2))["of"] == 2


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"marker": "  ", "note": "\t"},
        {"marker": 7},
        {"marker": "two\nlines"},
        {"marker": "half \ud800"},
        {"marker": "m" * (MAX_TEXT + 1)},
        {"marker": "m", "note": "n" * (MAX_TEXT + 1)},
        {"marker": "m", "source": "s" * (MAX_SOURCE + 1)},
        {"marker": "m", "kind": "undo"},
        {"marker": "m", "kind": "ready"},
        {"marker": "m", "kind": ["button"]},
        {"marker": "m", "at": "now"},
        {"marker": "m", "at": True},
        {"marker": "m", "at": float("nan")},
        {"marker": "m", "at": float("inf")},
        {"marker": "m", "at": 10**400},
    ],
)
async def test_what_is_no_marker_is_refused(desk: Desk, wrong: dict[str, Any]) -> None:
    assert (await desk.refusal("mark", **wrong)).reason is ConfigReason.WRONG_VALUE
    assert desk.stream.counters[SOURCE].pushed == 0


async def test_a_time_that_cannot_be_is_refused(desk: Desk) -> None:
    now = desk.stream.clock()
    for at in (now - MAX_AGE_S - 0.001, now + MAX_LEAD_S + 0.001):
        refused = str(await desk.refusal("mark", marker="m", at=at))
        assert "not an LSL time from 60 s ago to 0.1 s ahead" in refused
    for at in (now - MAX_AGE_S, now, now + MAX_LEAD_S):
        await desk.ask("mark", marker="m", at=at)
    await asyncio.sleep(0.002)
    assert "not an LSL time" in str(await desk.refusal("mark", marker="m", at=now - MAX_AGE_S))


@pytest.mark.parametrize("number", ["1", 1.0, True, [1]])
async def test_an_id_is_a_whole_number(desk: Desk, number: object) -> None:
    await desk.ask("mark", marker="m")
    assert (await desk.refusal("undo-marker", id=number)).reason is ConfigReason.WRONG_VALUE


@pytest.mark.nightly
async def test_the_longest_marker_arrives_whole(heard_desk: Desk) -> None:
    longest = "\U0001f600" * MAX_TEXT
    await heard_desk.ask("mark", marker=longest, note=longest)
    await eventually(heard_desk.has(1))
    (marker,) = heard_desk.pull()
    assert (marker["marker"], marker["note"]) == (longest, longest)


@pytest.mark.seam
async def test_whoever_begins_to_receive_gets_a_marker_at_once(desk: Desk) -> None:
    def ticks_until(condition: Callable[[], bool]) -> Callable[[], bool]:
        return lambda: desk.stream.tick(desk.stream.clock()) is None and condition()

    desk.stream.tick(desk.stream.clock())
    assert desk.stream.counters[SOURCE].pushed == 0
    desk.listen(await asyncio.to_thread(inlet, SOURCE))
    await eventually(ticks_until(desk.has(1)))
    ((ready, stamp),) = desk.heard
    assert (ready["kind"], ready["id"]) == ("ready", 1)
    assert ready["lsl_time"] == pytest.approx(stamp, abs=1e-6)
    for _ in range(5):
        desk.stream.tick(desk.stream.clock())
    assert desk.stream.counters[SOURCE].pushed == 1
    # It is nobody's marker, and nobody can undo it.
    assert (await desk.refusal("undo-marker", id=1)).reason is ConfigReason.NOT_FOUND
    assert (await desk.ask("markers"))["markers"] == []
    desk.stop_listening()
    await eventually(lambda: not desk.stream.is_received)
    # Only a tick notices it, so there is one before the next receiver comes.
    desk.stream.tick(desk.stream.clock())
    desk.listen(await asyncio.to_thread(inlet, SOURCE))
    await eventually(ticks_until(desk.has(2)))
    assert [marker["id"] for marker, _ in desk.heard] == [1, 2]


@pytest.mark.nightly
async def test_whoever_gets_another_marker_first_gets_only_that(heard_desk: Desk) -> None:
    await heard_desk.ask("mark", marker="m")
    heard_desk.stream.tick(heard_desk.stream.clock())
    await heard_desk.ask("mark", marker="n")
    await eventually(heard_desk.has(2))
    assert [each["marker"] for each in heard_desk.pull()] == ["m", "n"]


@pytest.mark.nightly
async def test_a_marker_that_nobody_receives_is_said(desk: Desk) -> None:
    with capture_logs() as logs:
        assert (await desk.ask("mark", marker="m"))["received"] is False
        assert [each["event"] for each in logs] == ["a marker was sent, but no program receives it"]
        await listened_to(desk)
        assert "received" not in await desk.ask("mark", marker="m")
        assert len(logs) == 1
    listed = (await desk.ask("markers"))["markers"]
    assert [each["received"] for each in listed] == [False, True]


async def test_without_a_stream_markers_are_refused_and_nothing_else_fails(
    virtual_clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_arguments: object) -> NoReturn:
        raise RuntimeError("no port is free")

    desk = Desk(virtual_clock)

    async def is_refused() -> None:
        with pytest.raises(TransportError) as caught:
            await desk.ask("mark", marker="m")
        assert caught.value.reason is TransportReason.UNAVAILABLE

    await is_refused()
    monkeypatch.setattr(outlets, "Outlet", refuse)
    with capture_logs() as logs:
        desk.stream.open()
        desk.stream.tick(desk.stream.clock())
        await is_refused()
        await desk.stream.end()
    assert [entry["event"] for entry in logs] == ["there is no stream of markers"]
    assert desk.stream.counters == {}


@pytest.mark.nightly
async def test_the_last_marker_is_heard_though_the_outlet_goes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # In real time, in which LSL sends; its threads may be held up for longer than a person waits.
    monkeypatch.setattr(marker_stream, "LINGER_S", 1.5)
    desk = Desk(LSL_CLOCK)
    desk.stream.open()
    await listened_to(desk)
    listening = asyncio.ensure_future(eventually(desk.has(1)))
    await desk.ask("mark", marker="m")
    await desk.stream.end()
    await listening


def buttons(path: Path, text: str) -> tuple[str, ...]:
    path.write_text(text, encoding="utf-8")
    return load_settings(path, {}).markers.buttons


def test_buttons_are_a_setting(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    assert buttons(path, "") == ("baseline", "stimulus on", "stimulus off")
    assert buttons(path, '[markers]\nbuttons = ["Ruhe", "Übung 1"]') == ("Ruhe", "Übung 1")
    assert buttons(path, "[markers]\nbuttons = []") == ()
    twenty = [f"b{number}" for number in range(20)]
    assert buttons(path, f"[markers]\nbuttons = {json.dumps(twenty)}") == tuple(twenty)


@pytest.mark.parametrize(
    "value",
    [
        '"baseline"',
        "[1]",
        '[""]',
        '[" baseline"]',
        '["two\\nlines"]',
        json.dumps(["b" * 33]),
        json.dumps([f"b{number}" for number in range(21)]),
    ],
)
def test_buttons_that_are_none_are_refused(tmp_path: Path, value: str) -> None:
    with pytest.raises(ConfigError, match=r"line 2: 'markers\.buttons'"):
        buttons(tmp_path / "settings.toml", f"[markers]\nbuttons = {value}")


def test_a_button_that_is_there_twice_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="should not have the same name twice, but has 'b'"):
        buttons(tmp_path / "settings.toml", '[markers]\nbuttons = ["a", "b", "b"]')


# ``biosensor-gateway mark``: a real agent, a real inlet, and the control channel beside it.

DEADLINE_S = 30.0
NO_AGENT = "biosensor-gateway: no agent is running; start one with: biosensor-gateway run\n"

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
def agent(tmp_path: Path) -> Generator[subprocess.Popen[bytes]]:
    """An agent without devices; they have no part in it."""
    (tmp_path / "settings.toml").write_text('[markers]\nbuttons = ["baseline", "task"]\n')
    arguments = ("run", "--settings", str(tmp_path / "settings.toml"), "--no-ask")

    def answers() -> bool:
        with suppress(GatewayError):
            return bool(control.ask(tmp_path, "markers"))
        return False

    with cli_process(tmp_path, *arguments) as process:
        wait_until(answers)
        yield process


@pytest.mark.seam
def test_what_is_marked_undone_and_listed(agent: subprocess.Popen[bytes], tmp_path: Path) -> None:
    reader = inlet(SOURCE)
    heard: list[dict[str, Any]] = []

    def has(count: int) -> bool:
        heard.extend(json.loads(row[0]) for row in reader.pull_chunk(timeout=0.0)[0])
        return len(heard) >= count

    wait_until(lambda: has(1))
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
            "biosensor-gateway: the agent refused undo-marker: marker 2 (baseline) is already "
            "undone\n"
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
    wait_until(lambda: has(6))
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
    wait_until(lambda: json.loads(counters.pull_sample()[0][0])[SOURCE]["pushed"] == len(heard))
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
    assert "not have the same name twice" in command(tmp_path, "reload")[2]
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
    with pytest.raises(ProtocolError, match="printable text with at most 200 characters") as caught:
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


def test_the_command_says_that_nobody_receives_a_marker(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
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
