"""Keeps what is known of recordings in the state folder.

Of LabRecorder's window that is the recording that was started last, because it cannot be asked. Of
our own, whether one runs is known by a lock that the operating system keeps for its supervisor and
gives back however that ends, so nobody is taken for it who got its number later.
"""

from __future__ import annotations

import contextlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from biosensor_gateway.recording.recorder.program import LAB_RECORDER
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


_FOLDER = "recorder"
_POLL_S = 0.05
_PATIENCE_S = 0.5
_AT_ONCE = "at once"


@dataclass(frozen=True, slots=True)
class Kept:
    """A recording, as its keeper wrote it down.

    Attributes
    ----------
    file
        Absolute path.
    required
        source_ids that it must have.
    started
        Unix time in s.
    program
        Process number of the program that records; 0 before it runs.
    ended
        Unix time in s; 0 while it runs, and for ever if the keeper was killed.
    code
        Exit code of the program; None while it runs.
    problem
        Why it ended without having been asked to; empty if it was asked.
    recorder
        What the program is, for a sentence.
    without
        source_ids of the sensors that did not stream when it was begun all the same, which a person
        has confirmed.
    """

    file: str
    required: tuple[str, ...]
    started: float
    program: int = 0
    ended: float = 0.0
    code: int | None = None
    problem: str = ""
    recorder: str = LAB_RECORDER
    without: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Job:
    """What the keeper is to run."""

    command: tuple[str, ...]
    kept: Kept


class RecorderFolder:
    """The files that starter, keeper and stopper share.

    Parameters
    ----------
    state
        The state folder.
    """

    def __init__(self, state: Path) -> None:
        self.path = state / _FOLDER
        self.said = self.path / "labrecorder.log"
        self.keeper_log = self.path / "keeper.log"
        self.lsl_config = self.path / "lsl_api.cfg"
        self._lock_file = self.path / "recorder.lock"
        self._job = self.path / "job.json"
        self._kept = self.path / "recording.json"
        self._stop = self.path / "stop"

    def lock(self) -> FileLock:
        """Return the lock that the keeper holds."""
        # The stand-in for file systems without locks would outlive a killed keeper.
        return FileLock(self._lock_file, fallback_to_soft=False)

    def is_kept(self) -> bool:
        """Whether a keeper is at work."""
        return not self.wait_until_free(0.0)

    def wait_until_free(self, limit_s: float) -> bool:
        """Wait until no keeper is at work; return whether that came in time."""
        if not self._lock_file.exists():
            return True
        lock = self.lock()
        try:
            lock.acquire(timeout=limit_s, poll_interval=_POLL_S)
        except Timeout:
            return False
        except OSError:
            # Whoever cannot have the lock here records without it.
            return True
        lock.release()
        return True

    def try_lock(self) -> FileLock | None:
        """Take the lock; None if a keeper has it. Who only looks has it for an instant."""
        lock = self.lock()
        try:
            lock.acquire(timeout=_PATIENCE_S, poll_interval=_POLL_S)
        except Timeout:
            return None
        return lock

    def give(self, job: Job, lsl_config: str) -> None:
        """Write down what a keeper is to do.

        Raises
        ------
        OSError
            It cannot be written.
        """
        state_file.make_folder(self.path)
        for old in (self._stop, self._kept, self.said):
            old.unlink(missing_ok=True)
        state_file.replace(self.lsl_config, lsl_config)
        state_file.replace(self._job, json.dumps(asdict(job)))

    def job(self) -> Job:
        """Return what the keeper is to do."""
        job: dict[str, Any] = json.loads(state_file.read(self._job))
        return Job(tuple(job["command"]), _kept(job["kept"]))

    def keep(self, kept: Kept) -> None:
        """Write down how the recording stands."""
        state_file.replace(self._kept, json.dumps(asdict(kept)))

    def kept(self) -> Kept | None:
        """Return how the recording stands that was begun last; None if it is over for all."""
        try:
            return _kept(json.loads(state_file.read(self._kept)))
        except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
            return None

    def forget(self) -> None:
        """Say that everybody knows that the recording is over."""
        with contextlib.suppress(OSError):
            self._kept.unlink()

    def ask_to_stop(self, *, at_once: bool = False) -> None:
        """Ask the keeper to end the recording.

        Parameters
        ----------
        at_once
            Nothing of it is wanted: a program that does not end is killed soon.

        Raises
        ------
        OSError
            It cannot be written.
        """
        state_file.replace(self._stop, _AT_ONCE if at_once else "")

    def is_asked_to_stop(self) -> bool:
        """Whether somebody wants the recording to end."""
        return self._stop.exists()

    def is_given_up(self) -> bool:
        """Whether whoever wants it to end wants nothing of it."""
        try:
            return state_file.read(self._stop) == _AT_ONCE
        except OSError:
            return False

    def what_was_said(self) -> str:
        """Return what the program has printed so far."""
        try:
            return self.said.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""


def _kept(content: dict[str, Any]) -> Kept:
    code = content["code"]
    return Kept(
        file=str(content["file"]),
        required=tuple(str(each) for each in content["required"]),
        started=float(content["started"]),
        program=int(content["program"]),
        ended=float(content["ended"]),
        code=None if code is None else int(code),
        problem=str(content["problem"]),
        recorder=str(content.get("recorder", LAB_RECORDER)),
        without=tuple(str(each) for each in content.get("without", ())),
    )
