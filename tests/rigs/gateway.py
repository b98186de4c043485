"""The agent's command line as a process, and its streams as another program finds them."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pylsl

from biosensor_gateway.recording.recorder.state import RecorderFolder, SavedRecording
from tests.open_outlets import outlets_of

DEADLINE_S = 30.0


@contextlib.contextmanager
def cli_process(
    folder: Path, *arguments: str, before: str = ""
) -> Generator[subprocess.Popen[bytes]]:
    """Run the command line as a process; state and stderr go into the given folder.

    ``before`` is Python that runs first, for what no real device does on demand.
    """
    environment = os.environ | {"BIOSENSOR_GATEWAY_STATE": str(folder)}
    code = f"{before}\nfrom biosensor_gateway.cli import main\nmain()"
    program = ["-c", code] if before else ["-m", "biosensor_gateway.cli"]
    command = [sys.executable, *program, *arguments]
    with (folder / "stderr.txt").open("wb") as stderr:
        process = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=stderr
        )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def inlet(source_id: str, *, recover: bool = False) -> pylsl.StreamInlet:
    """Find a stream by its source_id and begin to receive it.

    An inlet that does not recover gives nothing any more once its outlet has gone, not even
    what has arrived.
    """
    found = pylsl.resolve_byprop("source_id", source_id, timeout=DEADLINE_S)
    assert len(found) == 1
    reader = pylsl.StreamInlet(found[0], recover=recover)
    reader.open_stream(DEADLINE_S)
    # The sender has answered; only then it makes the queue for what is pushed.
    assert all(each.wait_for_consumers(DEADLINE_S) for each in outlets_of(source_id))
    return reader


def visible(source_id: str) -> bool:
    """Tell whether anybody offers a stream of that source_id."""
    return bool(pylsl.resolve_byprop("source_id", source_id, timeout=1.0))


@contextlib.contextmanager
def recording_going_on(state: Path) -> Generator[Path]:
    """Have a state folder say that a file is being recorded; yield the file, which is not there."""
    folder = RecorderFolder(state)
    folder.path.mkdir()
    file = state / "sub-P01_task-walk.xdf"
    folder.save(SavedRecording(str(file), (), 1.0))
    lock = folder.try_lock()
    assert lock is not None
    yield file
    lock.release()
