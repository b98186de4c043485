"""What the page says of a marker that is in no recording, and when each was."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any

import pytest

from biosensor_gateway.agent import control
from biosensor_gateway.page.marker_models import NewMarker
from biosensor_gateway.page.marking import Marking
from biosensor_gateway.page.models import RecordingView
from biosensor_gateway.page.session import Session


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
