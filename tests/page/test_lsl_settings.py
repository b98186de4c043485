"""What the page records and streams for a trial is in the LSL session of the settings."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from biosensor_common.lsl_config import LslOverrides
from biosensor_gateway.page.routes import devices
from biosensor_gateway.page.routes.recording import NewRecording, Recorder
from biosensor_gateway.page.session import Session
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.request import (
    RecorderError,
    RecorderReason,
    RecordingRequest,
)

SETTINGS = '[lsl]\nsession_id = "lab7"\nknown_peers = ["192.168.1.20"]\n'


def test_a_recording_looks_where_the_settings_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[LslOverrides | None] = []

    def start(
        _self: LocalRecorder,
        _request: RecordingRequest,
        _look: object,
        lsl: LslOverrides | None = None,
    ) -> None:
        told.append(lsl)
        raise RecorderError(RecorderReason.NOT_BEGUN, "not in this test")

    monkeypatch.setattr(LocalRecorder, "start", start)
    settings = tmp_path / "settings.toml"
    settings.write_text(SETTINGS)

    async def nobody(_participant: str) -> None:
        return None

    recording = Recorder(Session(tmp_path, settings), nobody)
    wanted = NewRecording(participant="p01", session="S001", task="rest", folder=str(tmp_path))
    with pytest.raises(RecorderError, match="not in this test"):
        asyncio.run(recording.start(wanted))
    assert told == [LslOverrides("lab7", ("192.168.1.20",))]


@pytest.mark.parametrize("virtual", [True, False])
def test_an_agent_has_the_settings_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, virtual: bool
) -> None:
    """Also one of virtual devices, and where there is no such file yet."""
    begun: list[tuple[Any, ...]] = []
    note: Callable[..., None] = lambda *arguments: begun.append(arguments)  # noqa: E731
    monkeypatch.setattr(devices, "start_beside", note)
    settings = tmp_path / "mine.toml"
    devices.start_agent(tmp_path, settings, virtual=virtual)
    ((words, environment),) = begun
    assert environment == {"BIOSENSOR_GATEWAY_SETTINGS": str(settings)}
    assert ("--settings" in words) is not virtual
    assert ("--simulate" in words) is virtual
