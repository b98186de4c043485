"""Stops a recording, and checks that its file is closed."""

from __future__ import annotations

import time
from pathlib import Path

from biosensor_gateway.recording.labrecorder.errors import LabRecorderError, LabRecorderReason
from biosensor_gateway.recording.labrecorder.memory import forget, recall
from biosensor_gateway.recording.labrecorder.recording_file import Glance, glance, wait_until_closed
from biosensor_gateway.recording.recorder.labrecorder import RemoteControl
from biosensor_gateway.recording.recorder.result import By, Stopped

STOP_REPLY_S = 60.0
"""Stopping waits up to five seconds for each of its threads."""
STILL_S = 2.0
"""LabRecorder takes in samples twice a second."""
CLOSING_S = 30.0


def stop(remote: RemoteControl, file: Path | None, state: Path) -> Stopped:
    """End the recording.

    Parameters
    ----------
    remote
        Connected.
    file
        The recording as this computer sees it; None for the one that was started
        from here.
    state
        The state folder.

    Raises
    ------
    LabRecorderError
        ``STILL_GROWING`` or ``NOT_CLOSED``, or whatever the remote control brings.
    """
    if file is None:
        last = recall(state, remote.host, remote.port)
        file = Path(last.file) if last is not None and last.file else None
    was_closed = file is not None and glance(file).is_closed
    begun = time.monotonic()
    remote.command("stop", STOP_REPLY_S)
    if file is None:
        forget(state)
        warnings = (_unknown(remote),)
        return Stopped(by=By.WINDOW, verified=False, file=None, verdict=None, warnings=warnings)
    seen = wait_until_closed(file, STILL_S, CLOSING_S)
    if seen is None:
        message = f"{file} still grows {CLOSING_S:g} s after LabRecorder was told to stop"
        raise LabRecorderError(LabRecorderReason.STILL_GROWING, message)
    if not seen.is_closed:
        raise LabRecorderError(LabRecorderReason.NOT_CLOSED, _not_closed(file, seen))
    forget(state)
    warnings = (f"{file} had been closed before",) if was_closed else ()
    return Stopped(
        by=By.WINDOW,
        verified=True,
        file=file,
        bytes=seen.bytes,
        streams=len(seen.streams),
        with_samples=len(seen.with_samples),
        took_s=time.monotonic() - begun,
        verdict=None,
        warnings=warnings,
    )


def _unknown(remote: RemoteControl) -> str:
    where = "on this computer" if remote.is_local else f"on another computer ({remote.host})"
    return (
        f"LabRecorder runs {where}, its answer says nothing, and which file it wrote is not known "
        "here: look at its window whether it stopped, or name the file with --file"
    )


def _not_closed(file: Path, seen: Glance) -> str:
    if not seen.bytes:
        return f"{file} is empty or not there: nothing was recorded to it"
    if not seen.is_whole:
        return (
            f"{file} does not grow any more, but breaks off or is damaged; look at it with: "
            f"biosensor-gateway xdf check {file}"
        )
    open_streams = len(seen.streams - seen.with_footer - seen.without_footer_due)
    return (
        f"{file} does not grow any more, but {open_streams} of its {len(seen.streams)} streams "
        f"were not closed; look at it with: biosensor-gateway xdf check {file}"
    )
