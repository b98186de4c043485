"""Gathers what can be known of LabRecorder and of the recording that was started last."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from biosensor_gateway.recording.labrecorder.errors import LabRecorderError
from biosensor_gateway.recording.labrecorder.memory import recall
from biosensor_gateway.recording.labrecorder.recording_file import glance, grows
from biosensor_gateway.recording.recorder.labrecorder import RemoteControl
from biosensor_gateway.recording.recorder.result import By, Standing
from biosensor_gateway.recording.xdf.findings import Finding, Level

GROWTH_S = 10.0
REPLY_S = 10.0
_NO_COMMAND = "status"
"""It knows no question, but answers to every line: so it is alive."""


def standing(host: str, port: int, file: Path | None, state: Path) -> Standing:
    """Look at LabRecorder and at its recording.

    Parameters
    ----------
    host, port
        Of its remote control.
    file
        The recording as this computer sees it; None for the one that was started
        from here.
    state
        The state folder.
    """
    problems: tuple[Finding, ...] = ()
    is_local = None
    try:
        with RemoteControl(host, port) as remote:
            is_local = remote.is_local
            remote.command(_NO_COMMAND, REPLY_S)
    except LabRecorderError as error:
        problems = (Finding(Level.ERROR, error.reason.value, "", str(error)),)
    last = recall(state, host, port)
    if file is None and last is not None and last.file:
        file = Path(last.file)
    known = Standing(
        by=By.WINDOW,
        recording=None,
        file=file,
        started=None if last is None else last.started,
        is_local=is_local,
        answers=not problems,
        problems=problems,
    )
    if file is None:
        return known
    seen = glance(file)
    return replace(
        known,
        recording=False if seen.is_closed else grows(file, GROWTH_S) or None,
        bytes=seen.bytes,
        streams=len(seen.streams),
        with_samples=len(seen.with_samples),
        is_closed=seen.is_closed,
    )
