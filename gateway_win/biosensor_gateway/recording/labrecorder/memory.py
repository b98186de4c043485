"""Remembers the recording that was started last, because LabRecorder does not tell."""

from __future__ import annotations

import contextlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from biosensor_gateway.system import state_file

MEMORY_FILE = "recording.json"


@dataclass(frozen=True, slots=True)
class Remembered:
    """A recording that was started from here.

    Attributes
    ----------
    host, port
        Of the LabRecorder.
    file
        Empty if it cannot be reached from this computer.
    started
        Unix time in s.
    """

    host: str
    port: int
    file: str
    started: float


def remember(folder: Path, recording: Remembered) -> str:
    """Keep it in the state folder; return what went wrong, empty if nothing did."""
    try:
        state_file.replace(folder / MEMORY_FILE, json.dumps(asdict(recording)))
    except OSError as error:
        return (
            f"{folder / MEMORY_FILE} cannot be written ({error.strerror or error}): tell "
            "`record stop` the file with --file"
        )
    return ""


def recall(folder: Path, host: str, port: int) -> Remembered | None:
    """Return the recording that was started last at this LabRecorder, if it is not over."""
    recording = last_started(folder)
    if recording is None:
        return None
    is_same = (_canonical(recording.host), recording.port) == (_canonical(host), port)
    return recording if is_same else None


def last_started(folder: Path) -> Remembered | None:
    """Return the recording that was started last at any LabRecorder, if it is not over."""
    try:
        kept: dict[str, Any] = json.loads((folder / MEMORY_FILE).read_text(encoding="utf-8"))
        return Remembered(
            str(kept["host"]), int(kept["port"]), str(kept["file"]), float(kept["started"])
        )
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        # Nothing, or nothing that can be used: then it is as if it was started by hand.
        return None


def _canonical(host: str) -> str:
    """Give the names of this computer by which everybody calls it one form."""
    lower = host.lower()
    return "localhost" if lower in {"127.0.0.1", "::1"} else lower


def forget(folder: Path) -> None:
    """Say that the recording is over."""
    with contextlib.suppress(OSError):
        (folder / MEMORY_FILE).unlink()
