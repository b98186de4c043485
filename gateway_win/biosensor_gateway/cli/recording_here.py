"""The part of ``biosensor-gateway record`` that needs no window of LabRecorder."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import typer

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import status_file
from biosensor_gateway.cli.questions import can_ask, menu
from biosensor_gateway.cli.recording_words import as_line, as_text, sight_text, standing_text
from biosensor_gateway.recording.recorder.labrecorder import RemoteControl
from biosensor_gateway.recording.recorder.live_file import Growth
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.request import (
    RecorderError,
    RecordingRequest,
    SensorsAwayError,
)
from biosensor_gateway.recording.recorder.state import WindowRecording
from biosensor_gateway.recording.recorder.streams import Devices
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.settings.places import state_folder

_WATCH_S = 2.0


def has_window(host: str, port: int) -> bool:
    """Whether LabRecorder's window listens there."""
    try:
        with RemoteControl(host, port):
            return True
    except RecorderError:
        return False


def may_be_of_window(host: str, port: int) -> bool:
    """Whether LabRecorder's window may be recording: it is open, or was told to."""
    return WindowRecording.last(state_folder()) is not None or has_window(host, port)


def is_of(file: Path | None) -> bool:
    """Whether a file, or whatever is recorded, is what this computer records by itself."""
    recorded = LocalRecorder(state_folder()).file
    return recorded is not None and (file is None or file.absolute() == recorded)


def without_sensors(request: RecordingRequest, error: SensorsAwayError) -> RecordingRequest:
    """Ask whether to record without sensors that do not stream.

    Raises
    ------
    SensorsAwayError
        If nobody can answer.
    typer.Exit
        With code 2 if it is not wanted.
    """
    if not can_ask():
        raise error
    said = " ".join(f"{each.rstrip('.')}." for each in error.sentences)
    if menu(said, ["Do not record yet", "Record without that"]) == 0:
        raise typer.Exit(2)
    return replace(request, without_away=True)


def _devices() -> Devices | None:
    try:
        return status_file.running_status(state_folder())["devices"]
    except ConfigError:
        return None


def status(*, watch: bool, as_json: bool) -> None:
    """Say how the recording of this computer itself stands; exit code 1 if not well."""
    recording = LocalRecorder(state_folder())
    in_json = as_line if watch else as_text
    standing = recording.status(_devices())
    while standing is not None:
        typer.echo(in_json(standing) if as_json else standing_text(standing))
        if not watch or not standing.recording:
            break
        time.sleep(_WATCH_S)
        # Who ends it in the meantime has seen the end of it.
        standing = recording.status(_devices())
    errors = () if standing is None else standing.problems
    if any(each.level is Level.ERROR for each in errors):
        raise typer.Exit(1)


def watch_file(file: Path, *, as_json: bool) -> None:
    """Say how the file of a window grows, until it is closed."""
    growth = Growth(file)
    while True:
        sight = growth.look()
        found = (*growth.problems(), *growth.gaps())
        typer.echo(as_line(sight) if as_json else sight_text(str(file), sight, found))
        if sight.is_closed:
            return
        time.sleep(_WATCH_S)
