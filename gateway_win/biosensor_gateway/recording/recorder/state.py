"""Keeps what is known of recordings in the state folder.

Of LabRecorder's window that is the recording that was started last, because it cannot be asked. Of
our own, the starter, the supervisor and whoever stops it share a folder; whether one runs is known
by a lock that the operating system keeps for its supervisor and gives back however that ends, so
nobody is taken for it who got its number later.
"""

from __future__ import annotations

import contextlib
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from biosensor_gateway.recording.recorder.program import LAB_RECORDER
from biosensor_gateway.system import state_file

WINDOW_FILE = "recording.json"
WRITTEN_WITHIN_S = 60.0
"""LabRecorder's window cannot be asked, and writes a slow stream about once a minute."""
_FOLDER = "recorder"
_POLL_S = 0.05
_PATIENCE_S = 0.5
_AT_ONCE = "at once"
_DAMAGED = (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError)


@dataclass(frozen=True, slots=True)
class SavedRecording:
    """A recording of this computer, as its supervisor saves it.

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
        Unix time in s; 0 while it runs, and for ever if the supervisor was killed.
    code
        Exit code of the program; None while it runs.
    problem
        Why it ended without having been asked to; empty if it was asked.
    recorder
        What the program is, for a sentence.
    without
        source_ids of the sensors that did not stream when it was begun all the same, which a person
        has confirmed.
    command
        The program's command line.
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
    command: tuple[str, ...] = ()

    @classmethod
    def read(cls, path: Path) -> SavedRecording:
        """Read one that this version or an earlier one has saved.

        Raises
        ------
        OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError
            If there is none, or it is damaged.
        """
        content: dict[str, Any] = json.loads(state_file.read(path))
        code = content["code"]
        return cls(
            file=str(content["file"]),
            required=tuple(str(each) for each in content["required"]),
            started=float(content["started"]),
            program=int(content["program"]),
            ended=float(content["ended"]),
            code=None if code is None else int(code),
            problem=str(content["problem"]),
            recorder=str(content.get("recorder", LAB_RECORDER)),
            without=tuple(str(each) for each in content.get("without", ())),
            command=tuple(str(each) for each in content.get("command", ())),
        )


class RecorderFolder:
    """The files that starter, supervisor and stopper share, in the state folder."""

    def __init__(self, state: Path) -> None:
        self.path = state / _FOLDER
        self.output = self.path / "labrecorder.log"
        self.supervisor_log = self.path / "keeper.log"
        self.lsl_config = self.path / "lsl_api.cfg"
        self._lock_file = self.path / "recorder.lock"
        self._request = self.path / "job.json"
        self._saved = self.path / "recording.json"
        self._stop = self.path / "stop"

    @property
    def is_running(self) -> bool:
        """Whether a supervisor is at work."""
        return not self.wait_until_free(0.0)

    def wait_until_free(self, limit_s: float) -> bool:
        """Wait until no supervisor is at work; return whether that came in time."""
        if not self._lock_file.exists():
            return True
        lock = self._lock()
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
        """Take the lock; None if a supervisor has it. Who only looks has it for an instant."""
        lock = self._lock()
        try:
            lock.acquire(timeout=_PATIENCE_S, poll_interval=_POLL_S)
        except Timeout:
            return None
        return lock

    def _lock(self) -> FileLock:
        # The stand-in for file systems without locks would outlive a killed supervisor.
        return FileLock(self._lock_file, fallback_to_soft=False)

    def hand_over(self, recording: SavedRecording, lsl_config: str) -> None:
        """Write down what a supervisor is to record.

        Raises
        ------
        OSError
            It cannot be written.
        """
        state_file.make_folder(self.path)
        for old in (self._stop, self._saved, self.output):
            old.unlink(missing_ok=True)
        state_file.replace(self.lsl_config, lsl_config)
        state_file.replace(self._request, json.dumps(asdict(recording)))

    def requested(self) -> SavedRecording:
        """Return what the supervisor is to record."""
        return SavedRecording.read(self._request)

    def save(self, recording: SavedRecording) -> None:
        """Write down how the recording stands."""
        state_file.replace(self._saved, json.dumps(asdict(recording)))

    def saved(self) -> SavedRecording | None:
        """Return how the recording stands that was begun last; None if it is over for all."""
        try:
            return SavedRecording.read(self._saved)
        except _DAMAGED:
            return None

    def forget(self) -> None:
        """Say that everybody knows that the recording is over."""
        with contextlib.suppress(OSError):
            self._saved.unlink()

    def ask_to_stop(self, *, at_once: bool = False) -> None:
        """Ask the supervisor to end the recording; *at_once* if nothing of it is wanted.

        Raises
        ------
        OSError
            It cannot be written.
        """
        state_file.replace(self._stop, _AT_ONCE if at_once else "")

    @property
    def is_asked_to_stop(self) -> bool:
        """Whether somebody wants the recording to end."""
        return self._stop.exists()

    @property
    def is_given_up(self) -> bool:
        """Whether whoever wants it to end wants nothing of it."""
        try:
            return state_file.read(self._stop) == _AT_ONCE
        except OSError:
            return False

    def printed(self) -> str:
        """Return what the program has printed so far."""
        try:
            return self.output.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""


@dataclass(frozen=True, slots=True)
class WindowRecording:
    """A recording that was started from here at a LabRecorder.

    Attributes
    ----------
    host, port
        Of its remote control.
    file
        Empty if it cannot be reached from this computer.
    started
        Unix time in s.
    """

    host: str
    port: int
    file: str
    started: float

    def save(self, state: Path) -> str:
        """Keep it in the state folder; return what went wrong, empty if nothing did."""
        try:
            state_file.replace(state / WINDOW_FILE, json.dumps(asdict(self)))
        except OSError as error:
            return (
                f"{state / WINDOW_FILE} cannot be written ({error.strerror or error}): tell "
                "`record stop` the file with --file"
            )
        return ""

    @classmethod
    def last(cls, state: Path) -> WindowRecording | None:
        """Return the one that was started last at any LabRecorder, if it is not over."""
        try:
            content: dict[str, Any] = json.loads((state / WINDOW_FILE).read_text(encoding="utf-8"))
            host, port = str(content["host"]), int(content["port"])
            return cls(host, port, str(content["file"]), float(content["started"]))
        except _DAMAGED:
            # Nothing, or nothing that can be used: then it is as if it was started by hand.
            return None

    @classmethod
    def last_at(cls, state: Path, host: str, port: int) -> WindowRecording | None:
        """Return the one that was started last at this LabRecorder, if it is not over."""
        last = cls.last(state)
        is_same = last and (_canonical(last.host), last.port) == (_canonical(host), port)
        return last if is_same else None

    @staticmethod
    def forget(state: Path) -> None:
        """Say that the recording is over."""
        with contextlib.suppress(OSError):
            (state / WINDOW_FILE).unlink()


def _canonical(host: str) -> str:
    """Give the names of this computer by which everybody calls it one form."""
    lower = host.lower()
    return "localhost" if lower in {"127.0.0.1", "::1"} else lower


def file_going_on(state: Path) -> Path | None:
    """Return the file that is recorded to now, for whoever is about to change what is recorded.

    That is the recording of this computer itself, or what LabRecorder's window was told to record
    by ``record start``; None if none is known.
    """
    folder = RecorderFolder(state)
    saved = folder.saved() if folder.is_running else None
    if saved is not None:
        return Path(saved.file)
    last = WindowRecording.last(state)
    if last is None or not last.file:
        return None
    file = Path(last.file)
    try:
        is_written = time.time() - file.stat().st_mtime < WRITTEN_WITHIN_S
    except OSError:
        return None
    return file if is_written else None
