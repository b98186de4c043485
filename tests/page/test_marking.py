"""What the page says of a marker that is in no recording, and when each was."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any

import pytest

from biosensor_gateway.agent import control
from biosensor_gateway.agent.status import AgentStatus
from biosensor_gateway.page.models import RecordingView
from biosensor_gateway.page.routes.markers import MarkerButtons, Marking, NewMarker
from biosensor_gateway.page.session import Session
from biosensor_gateway.settings.file import load_settings


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session(tmp_path, tmp_path / "settings.toml")


@pytest.mark.parametrize(
    ("answer", "is_running", "said"),
    [
        ({}, True, "Marked: task"),
        ({}, False, "Marked: task; this page records nothing."),
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
