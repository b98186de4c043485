"""Who wears the sensors is compared with what the file is called, before anything is recorded."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from biosensor_common.errors import ConfigReason
from biosensor_gateway.agent.status_file import write_status
from biosensor_gateway.recording.participants import OtherParticipantsError, Worn
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.request import (
    BidsLabels,
    RecorderReason,
    RecordingRequest,
    SensorsAwayError,
)
from biosensor_gateway.recording.recorder.streams import (
    Presence,
    VisibleStream,
    expected_devices,
    require_startable,
)
from biosensor_gateway.settings.models import GatewaySettings

SEEN = VisibleStream("P01-polar_h10-A1-ecg", "P01@polar_h10-ecg", "lab-pc")
PRESENCE = Presence((SEEN,), (), (), (Worn("polar_h10/A1", "P01"),))


def request(participant: str, **more: Any) -> RecordingRequest:
    return RecordingRequest(Path("/data"), labels=BidsLabels(participant), **more)


@pytest.mark.parametrize(
    "confirmed",
    [
        request("P01"),
        RecordingRequest(file=Path("walk.xdf")),
        RecordingRequest(Path("/data")),
        request("P03", other_participants=True),
    ],
)
def test_what_agrees_or_is_confirmed_is_recorded(confirmed: RecordingRequest) -> None:
    require_startable(PRESENCE, PRESENCE.visible, confirmed)


@pytest.mark.parametrize(
    "where", [request("P03"), RecordingRequest(file=Path("/data/sub-P03_task-a.xdf"))]
)
def test_another_participant_is_refused_and_the_option_named(where: RecordingRequest) -> None:
    with pytest.raises(OtherParticipantsError, match="--other-participants") as caught:
        require_startable(PRESENCE, PRESENCE.visible, where)
    # The command line makes exit code 2 of it.
    assert caught.value.reason is ConfigReason.WRONG_VALUE
    assert "the file is called P03, but its sensors are worn by P01" in str(caught.value)


def test_nothing_is_made_of_a_recording_that_is_refused(tmp_path: Path) -> None:
    order = RecordingRequest(tmp_path, labels=BidsLabels("P03"))
    recording = LocalRecorder(tmp_path / "state")
    with pytest.raises(OtherParticipantsError):
        recording.start(order, lambda: PRESENCE)
    assert list(tmp_path.rglob("*.xdf")) == []
    assert not recording.is_running


def test_a_sensor_that_does_not_stream_refuses_and_the_option_is_named(tmp_path: Path) -> None:
    presence = replace(PRESENCE, away=("P01's strap is paused since 14:03",))
    recording = LocalRecorder(tmp_path / "state")
    with pytest.raises(SensorsAwayError, match="P01's strap is paused since 14:03") as caught:
        recording.start(RecordingRequest(tmp_path, labels=BidsLabels("P01")), lambda: presence)
    assert "--allow-missing" in str(caught.value)
    assert caught.value.reason is RecorderReason.STREAMS_MISSING
    assert list(tmp_path.rglob("*.xdf")) == []
    require_startable(presence, presence.visible, request("P01", without_away=True))


def test_what_the_agent_says_of_a_pause_is_known_before_it_begins(tmp_path: Path) -> None:
    known: dict[str, object] = {"sensor": "polar_h10", "participant": "P01", "label": "",
                                "error": None, "paused": False, "streams": {}}  # fmt: skip
    devices: list[dict[str, object]] = [
        {**known, "unit": "A1", "state": "streaming", "paused": True, "since": 1.0},
        {**known, "unit": "A2", "state": "streaming"},
        # A part of its streams may be all that it ever sends.
        {**known, "unit": "A3", "state": "streaming", "error": "no data of acc"},
        {**known, "unit": "A4", "state": "discovering", "since": 1.0},
    ]
    write_status(tmp_path, {"written": time.time(), "devices": devices})
    found = expected_devices(GatewaySettings(), tmp_path)
    told = [each.away.partition(" since ")[0] for each in found]
    assert told == ["P01's Polar H10 A1 is paused", "", "", "P01's Polar H10 A4 is not found"]
