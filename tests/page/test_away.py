"""*Record* asks before it begins without a sensor, and names it while it lasts."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from biosensor_gateway.agent.status import AgentStatus, DeviceStatus
from biosensor_gateway.page.routes.recording import Story
from biosensor_gateway.recording.recorder.result import By, LocalStarted, LocalStatus
from biosensor_gateway.recording.recorder.streams import VisibleStream
from tests.page.test_whose import BELT, Page

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
    assert told(story, belt(paused=True, since=STARTED), belt(unit="C")) == []
    # While the agent is away, nobody knows how its sensors are.
    assert told(story) == []
    (note,) = told(story, belt(), belt(unit="C", state="connecting", since=STARTED))
    assert "Zephyr BioHarness 3 B was paused from" in note
    notes = told(story, belt(), belt(unit="C"))
    assert len(notes) == 2
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
    assert named.startswith("streams of other programs are recorded, too: ")
    assert "P02-polar_h10-B2-hr_live" in named
    assert "amplifier" in named
