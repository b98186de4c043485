"""Gathers what can be known of LabRecorder and of the recording that was started last."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from biosensor_gateway.recording.labrecorder.errors import LabRecorderError
from biosensor_gateway.recording.labrecorder.memory import recall
from biosensor_gateway.recording.labrecorder.recording_file import glance, grows
from biosensor_gateway.recording.labrecorder.remote import RemoteControl

GROWTH_S = 10.0
REPLY_S = 10.0
_NO_COMMAND = "status"
"""It knows no question, but answers to every line: so it is alive."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What is known.

    Attributes
    ----------
    problem
        Why LabRecorder cannot be steered; empty if it answers.
    recording
        Whether it records to `file`; None if that cannot be known.
    file
        What was started last from here; None if that is not known.
    """

    problem: str
    is_local: bool | None
    recording: bool | None
    file: Path | None
    bytes: int
    streams: int
    with_samples: int
    is_closed: bool
    started: float | None

    @property
    def answers(self) -> bool:
        """Whether LabRecorder answers."""
        return not self.problem


def situation(host: str, port: int, file: Path | None, state: Path) -> Situation:
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
    problem, is_local = "", None
    try:
        with RemoteControl(host, port) as remote:
            is_local = remote.is_local
            remote.command(_NO_COMMAND, REPLY_S)
    except LabRecorderError as error:
        problem = str(error)
    last = recall(state, host, port)
    started = last.started if last is not None else None
    if file is None and last is not None and last.file:
        file = Path(last.file)
    if file is None:
        return Situation(problem, is_local, None, None, 0, 0, 0, False, started)
    seen = glance(file)
    recording = False if seen.is_closed else grows(file, GROWTH_S) or None
    return Situation(
        problem=problem,
        is_local=is_local,
        recording=recording,
        file=file,
        bytes=seen.bytes,
        streams=len(seen.streams),
        with_samples=len(seen.with_samples),
        is_closed=seen.is_closed,
        started=started,
    )
