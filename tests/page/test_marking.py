"""What the page says of a marker that is in no recording, and when each was."""

from __future__ import annotations

import asyncio
import os
import time
from pathlib import Path
from typing import Any

import pylsl
import pytest
from playwright.sync_api import expect

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.stream_header import PREFIX
from biosensor_gateway.agent import control
from biosensor_gateway.agent.status import AgentStatus, DeviceStatus
from biosensor_gateway.page.models import RecordingView
from biosensor_gateway.page.routes.markers import MarkerButtons, Marking, NewMarker
from biosensor_gateway.page.routes.recording import Story
from biosensor_gateway.page.routes.replay import MOST_LISTED, recordings, whole_path
from biosensor_gateway.page.session import Session
from biosensor_gateway.recording.recorder.request import (
    By,
    LocalStarted,
    LocalStatus,
    VisibleStream,
)
from biosensor_gateway.settings.file import load_settings
from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S, Server
from tests.page.test_whose import BELT, Page
from tests.page.test_window import OpenWindow
from tests.replay import files
from tests.rigs.polling import wait_until


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session(tmp_path, tmp_path / "settings.toml")


@pytest.mark.parametrize(
    ("answer", "is_running", "said"),
    [
        ({}, True, "Marked: task"),
        ({}, False, "Marked: task; this page is not recording."),
        ({"received": False}, False, "Marked: task, but no program receives it"),
        # Its stream is not in the file.
        ({"received": False}, True, "Marked: task, but no program receives it"),
    ],
)
def test_what_becomes_of_it_is_said(
    answer: dict[str, Any],
    is_running: bool,
    said: str,
    session: Session,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    marked = {"id": 1, "marker": "task", "note": "", "kind": "button", "source": "page",
              "lsl_time": session.now() - 60.0, "undone": False, **answer}  # fmt: skip

    def ask(_folder: Path, command: str, _arguments: object) -> dict[str, Any]:
        return answer if command == "mark" else {"markers": [marked], "buttons": ["task"]}

    monkeypatch.setattr(control, "ask", ask)
    session.recording = RecordingView(is_running=is_running)
    sentence = asyncio.run(Marking(session).mark(NewMarker(marker="task")))
    assert sentence.startswith(said)
    (shown,) = session.markers.markers
    assert shown.time == pytest.approx(time.time() - 60.0, abs=30.0)
    assert shown.received is answer.get("received", True)


class Agent:
    """Keeps markers as an agent does, and forgets them when it is started again."""

    def __init__(self, session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
        self._session = session
        self.asked: list[str] = []
        monkeypatch.setattr(control, "ask", self._ask)
        self.start()

    def start(self) -> None:
        self._session.take_status(None)
        self._markers: list[dict[str, Any]] = []
        self._session.take_status(AgentStatus())

    def _ask(self, _folder: Path, command: str, arguments: Any) -> dict[str, Any]:
        self.asked.append(command)
        if command == "mark":
            self._markers.append({**arguments, "id": len(self._markers) + 1, "undone": False,
                                  "lsl_time": arguments["at"]})  # fmt: skip
        return {"markers": self._markers, "buttons": []} if command == "markers" else {}


def shown(session: Session) -> list[tuple[str, bool, bool]]:
    return [(each.marker, each.earlier, each.can_be_undone) for each in session.markers.markers]


def test_those_of_the_participant_before_stand_apart_and_none_is_forgotten(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent, marking = Agent(session, monkeypatch), Marking(session)
    # Until the agent has said which buttons there are, nobody is to name them.
    assert not session.markers.told

    def mark(name: str) -> None:
        asyncio.run(marking.mark(NewMarker(marker=name)))

    mark("of P01")
    session.recording = RecordingView(is_running=True, started=time.time())
    mark("of P02")
    assert shown(session) == [("of P01", True, False), ("of P02", False, True)]
    assert session.markers.told
    # The recording is over: until the next one its markers are the newest ones.
    session.recording = RecordingView()
    mark("behind it")
    assert shown(session)[1:] == [("of P02", False, True), ("behind it", False, True)]

    # Another agent counts again, and can undo none of them.
    agent.start()
    mark("of another")
    names = ["of P01", "of P02", "behind it", "of another"]
    assert [each.marker for each in session.markers.markers] == names
    assert [each.can_be_undone for each in session.markers.markers] == [False] * 3 + [True]
    mark("one more")
    assert [each.marker for each in session.markers.markers] == [*names, "one more"]


def test_buttons_are_named_in_the_settings_and_hold_at_once(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent = Agent(session, monkeypatch)
    wanted = MarkerButtons(buttons=["rest", "task"])
    asyncio.run(Marking(session).name_buttons(wanted))
    assert load_settings(session.settings, {}).markers.buttons == ("rest", "task")
    assert "reload" in agent.asked


# *Record* asks before it begins without a sensor, and names it while it lasts.
STARTED = 1000.0


def belt(**changes: Any) -> DeviceStatus:
    usual: dict[str, Any] = {
        "sensor": "zephyr", "unit": "B", "participant": "P01", "label": "", "state": "streaming",
        "paused": False, "worn": None, "connections": 1, "error": None, "dropped_bytes": 0,
        "battery_percent": None, "clock": None, "streams": {},
    }  # fmt: skip
    return DeviceStatus(**(usual | changes))


@pytest.mark.parametrize(
    ("change", "how"),
    [
        ({"paused": True}, "is paused since"),
        ({"state": "discovering"}, "is not found since"),
        ({"state": "connecting"}, "is not connected since"),
        ({"state": "backoff", "error": "the port is in use"}, ": the port is in use."),
        ({"state": "enabling"}, "does not send all of its streams since"),
    ],
)
def test_without_a_sensor_it_is_asked(change: dict[str, Any], how: str, tmp_path: Path) -> None:
    page = Page(tmp_path, BELT.format("P01"))
    devices = [belt(since=time.time(), **change), belt(unit="C", label="left")]
    page.session.take_status(AgentStatus(devices=devices))
    code, answer = page.ask("POST", "recording/start", {"participant": "P01"})
    assert (code, answer["title"]) == (409, "A sensor does not stream")
    assert answer["problem"].startswith("P01's Zephyr BioHarness 3 ")
    assert how in answer["problem"]
    assert answer["problem"].endswith(". Record without it?")
    assert answer["choices"] == [{"words": "Record without it", "more": {"without_away": True}}]
    assert not page.session.recording.busy


def test_several_are_one_question(tmp_path: Path) -> None:
    page = Page(tmp_path, BELT.format("P01"))
    devices = [belt(unit=unit, paused=True, since=time.time()) for unit in "BC"]
    page.session.take_status(AgentStatus(devices=devices))
    _, answer = page.ask("POST", "recording/start", {"participant": "P01"})
    assert answer["title"] == "2 sensors do not stream"
    assert answer["problem"].count("is paused") == 2
    assert answer["choices"][0]["words"] == "Record without them"


def told(story: Story, *devices: DeviceStatus) -> list[str]:
    standing = LocalStatus(by=By.GATEWAY, recording=True, file=Path("/data/a.xdf"), started=STARTED)
    story.look([each.model_dump() for each in devices], standing)
    return story.notes


def test_what_is_over_stays_said() -> None:
    story = Story()
    assert told(story, belt(error="no ecg", since=STARTED), belt(unit="C")) == []
    # While the agent is away, nobody knows how its sensors are.
    assert told(story) == []
    (note,) = told(story, belt(), belt(unit="C", state="enabling", since=STARTED))
    assert "Zephyr BioHarness 3 B did not send all of its data from" in note
    notes = told(story, belt(), belt(unit="C"))
    assert len(notes) == 2
    assert told(story, belt(), belt(unit="C")) == notes
    # Who was paused or not connected is told by the events in the file.
    told(story, belt(paused=True, since=STARTED), belt(unit="C", state="connecting"))
    assert told(story, belt(), belt(unit="C")) == notes


def test_another_recording_has_a_story_of_its_own() -> None:
    story = Story()
    told(story, belt())
    standing = LocalStatus(by=By.GATEWAY, recording=True, file=Path("/b.xdf"), started=STARTED)
    assert not story.is_of(standing)


def begun(*foreign: VisibleStream) -> LocalStarted:
    own = VisibleStream("P01-polar_h10-A1-ecg", "P01@polar_h10-ecg", "lab-pc")
    return LocalStarted(
        by=By.GATEWAY, verified=True, file=Path("/data/a.xdf"), bytes=1, took_s=1.0,
        streams=(own, *foreign), foreign=foreign, warnings=(), left_out=(),
    )  # fmt: skip


def test_streams_of_others_are_named_and_live_features_counted() -> None:
    assert Story(begun()).remarks == []
    rate = VisibleStream("P01-polar_h10-A1-hr_live", "P01@polar_h10-hr_live", "lab-pc")
    assert Story(begun(rate)).remarks == ["1 stream of live features is recorded, too"]
    of_other = VisibleStream("P02-polar_h10-B2-hr_live", "P02@polar_h10-hr_live", "lab-pc")
    eeg = VisibleStream("amplifier", "", "eeg-pc")
    counted, named = Story(begun(rate, rate, of_other, eeg)).remarks
    assert counted == "2 streams of live features are recorded, too"
    assert named.startswith("streams of other programs are also recorded: ")
    assert "P02-polar_h10-B2-hr_live" in named
    assert "amplifier" in named


# A recording played on the page: what is seen of it, who is told, and how it ends.

LONG_S = 600.0


@pytest.mark.nightly
def test_a_recording_is_played_marked_and_ended(
    server: Server, window: OpenWindow, tmp_path: Path
) -> None:
    recording = files.write(
        tmp_path / "study.xdf",
        files.regular(1, "sine[1]", 50.0, LONG_S, source_id="a"),
        files.regular(2, "other", 10.0, LONG_S, source_id="b"),
        files.texts(3, "marks", [0.5, 1.0], source_id="c"),
    )
    page = window()
    page.goto(server.address)
    page.get_by_role("banner").get_by_role("button", name="Play a recording").click()
    panel = page.get_by_role("region", name="Play a recording")
    panel.get_by_label("Recording").select_option("another file …")
    panel.get_by_label("full path").fill("study.xdf")
    expect(panel.get_by_role("alert")).to_contain_text("not the full path")
    panel.get_by_label("full path").fill(str(recording))
    expect(panel.get_by_text("0:09:59 long, 3 streams")).to_be_visible()
    panel.get_by_text("Streams: all").click()
    panel.get_by_role("checkbox", name="other").uncheck()
    play = panel.get_by_role("button", name="Play", exact=True)
    panel.get_by_label("From").fill("1:00:00")
    play.click()
    expect(page.locator(".toast")).to_contain_text("has no samples in the selection")
    panel.get_by_label("From").fill("0:10")
    panel.get_by_label("Speed").select_option("2 times")
    play.click()

    notice = page.get_by_role("region", name="Replay: a recording, not a person")
    expect(notice).to_contain_text("study.xdf at 2 times its speed")
    card = page.locator(".card")
    expect(card).to_have_count(1)
    expect(card).to_contain_text("replay, not a person")
    spark = card.locator("canvas").element_handle()
    before = page.evaluate("canvas => canvas.toDataURL()", spark)
    page.wait_for_function("([canvas, was]) => canvas.toDataURL() !== was", arg=[spark, before])
    (found,) = pylsl.resolve_byprop("name", "sine[1]", timeout=DEADLINE_S)
    assert found.source_id().startswith(PREFIX)
    assert found.nominal_srate() == 100.0
    expect(notice).to_contain_text("of 2 streams received")
    assert violations(page) == []

    card.get_by_role("button", name="Traces and details").click()
    expect(page.get_by_text("nobody is being measured now")).to_be_visible()
    expect(page.locator("tr", has_text="sine[1]")).to_contain_text("of 100 Hz")
    expect(page.get_by_role("button", name="Pause")).to_have_count(0)

    notice.get_by_role("button", name="End the replay").click()
    over = page.get_by_role("region", name="The replay has ended")
    expect(over).to_contain_text("samples were sent")
    expect(page.locator(".card")).to_have_count(0)
    over.get_by_role("button", name="Close").click()
    expect(over).to_have_count(0)
    page.reload()
    expect(page.get_by_role("heading", name="Biosensor Gateway")).to_be_visible()
    expect(over).to_have_count(0)


@pytest.mark.nightly
def test_a_replay_ends_with_the_page(server: Server, tmp_path: Path) -> None:
    recording = files.write(tmp_path / "a.xdf", files.regular(1, "alone", 4.0, LONG_S))
    cookie = server.enter()
    wanted = {"path": str(recording), "streams": ["alone"]}
    assert server.tell("POST", "replay/start", cookie, wanted).status == 200
    again = server.tell("POST", "replay/start", cookie, wanted)
    assert (again.status, b"already being played" in again.body) == (409, True)
    resolver = pylsl.ContinuousResolver(prop="name", value="alone", forget_after=1.0)
    wait_until(lambda: bool(resolver.results()))
    server.process.terminate()
    server.process.wait(DEADLINE_S)
    wait_until(lambda: not resolver.results())


def test_recordings_are_listed_the_newest_first(tmp_path: Path) -> None:
    inner = tmp_path / "sub-1" / "beh"
    inner.mkdir(parents=True)
    for age in range(MOST_LISTED + 3):
        file = inner / f"{age}.xdf"
        file.write_bytes(b"x")
        os.utime(file, (1e9 - age, 1e9 - age))
    (inner / "notes.txt").write_text("none")
    found = recordings([tmp_path, inner, tmp_path / "not there"])
    assert [each.name for each in found] == [f"{age}.xdf" for age in range(MOST_LISTED)]
    assert found[0].path == str(inner / "0.xdf")


def test_a_path_must_be_whole() -> None:
    with pytest.raises(ConfigError) as caught:
        whole_path("study.xdf")
    assert caught.value.reason is ConfigReason.WRONG_VALUE
