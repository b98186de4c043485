"""Says whether something is recorded, for whoever is about to change what is there to record."""

from __future__ import annotations

import time
from pathlib import Path

from biosensor_gateway.recording.recorder.local import Recording
from biosensor_gateway.recording.recorder.state import last_started

WRITTEN_WITHIN_S = 60.0
"""LabRecorder's window cannot be asked, and writes a slow stream about once a minute."""


def file_going_on(state: Path) -> Path | None:
    """Return the file that is recorded to now; None if none is known.

    That is the recording of this computer itself, or what LabRecorder's window was told to
    record by ``record start``.

    Parameters
    ----------
    state
        The state folder.
    """
    own = Recording(state).file_going_on
    if own is not None:
        return own
    last = last_started(state)
    if last is None or not last.file:
        return None
    file = Path(last.file)
    try:
        is_written = time.time() - file.stat().st_mtime < WRITTEN_WITHIN_S
    except OSError:
        return None
    return file if is_written else None
