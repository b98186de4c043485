"""Stores information about recordings in the state folder.

For LabRecorder's window it is the recording started last, because the window cannot be queried.
For our own recordings, the processes that start, supervise and stop them share a folder. A file
lock shows whether a supervisor runs: the operating system releases it however the process ends, so
a later process with the same id is not mistaken for it.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from filelock import FileLock, Timeout

from biosensor_common import naming
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.recording.participants import listed
from biosensor_gateway.recording.xdf.findings import VisibleStream
from biosensor_gateway.system import state_file

if TYPE_CHECKING:
    from biosensor_gateway.settings.models import DeviceSettings

LAB_RECORDER, OWN = "LabRecorder's program", "the gateway's own recorder"
"""Names in sentences of the programs that record."""
WINDOW_FILE = "recording.json"
WRITTEN_WITHIN_S = 60.0
"""LabRecorder's window cannot be queried, and writes a slow stream about once a minute."""
_FOLDER = "recorder"
_POLL_S = 0.05
_PATIENCE_S = 0.5
_AT_ONCE = "at once"
_DAMAGED = (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError)


class ClockStep(NamedTuple):
    """A step of the time of day against the monotonic clock: set, or the computer slept."""

    at: float  # Unix time in s, by the clock after it.
    by_s: float


@dataclass(frozen=True, slots=True)
class SavedRecording:
    """A recording made on this computer, as saved by its supervisor."""

    file: str  # Absolute path.
    required: tuple[str, ...]  # source_ids that it must contain.
    started: float  # Unix time in s.
    program: int = 0  # Process id of the recording program; 0 before it runs.
    ended: float = 0.0  # Unix time in s; 0 while it runs, and also if the supervisor was killed.
    code: int | None = None  # Exit code of the program; None while it runs.
    problem: str = ""  # Why it ended without a request; empty if it was stopped on request.
    recorder: str = LAB_RECORDER  # Name of the program in sentences.
    # source_ids of the sensors that did not stream at the start, which the user confirmed.
    without: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    # Streams that were visible at the start; None if later ones are left out on purpose.
    visible: tuple[VisibleStream, ...] | None = None
    late: tuple[VisibleStream, ...] = ()  # Streams that appeared since.
    clock_steps: tuple[ClockStep, ...] = ()  # Steps of this computer's clock since.

    @property
    def began(self) -> float:
        """Unix time of its start by the clock as it is now, in s; without sleep since."""
        return self.started + sum(each.by_s for each in self.clock_steps)

    @classmethod
    def read(cls, path: Path) -> SavedRecording:
        """Read a recording that this or an earlier version saved.

        Raises
        ------
        OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError
            If it does not exist or is damaged.
        """
        content: dict[str, Any] = json.loads(state_file.read(path))
        code, visible = content["code"], content.get("visible")
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
            visible=None if visible is None else tuple(VisibleStream(**each) for each in visible),
            late=tuple(VisibleStream(**each) for each in content.get("late", ())),
            clock_steps=tuple(
                ClockStep(float(at), float(by_s)) for at, by_s in content.get("clock_steps", ())
            ),
        )


class RecorderFolder:
    """The files in the state folder that start, supervise and stop a recording."""

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
        """Whether a supervisor runs."""
        return not self.wait_until_free(0.0)

    def wait_until_free(self, limit_s: float) -> bool:
        """Wait until no supervisor runs; return False after the time limit."""
        if not self._lock_file.exists():
            return True
        lock = self._lock()
        try:
            lock.acquire(timeout=limit_s, poll_interval=_POLL_S)
        except Timeout:
            return False
        except OSError:
            # Where a lock is impossible, recordings run without it.
            return True
        lock.release()
        return True

    def try_lock(self) -> FileLock | None:
        """Take the lock; None if a supervisor holds it."""
        lock = self._lock()
        # With patience, because a check whether one runs holds it for a moment, too.
        try:
            lock.acquire(timeout=_PATIENCE_S, poll_interval=_POLL_S)
        except Timeout:
            return None
        return lock

    def _lock(self) -> FileLock:
        # The fallback for file systems without locks would outlive a killed supervisor.
        return FileLock(self._lock_file, fallback_to_soft=False)

    def hand_over(self, recording: SavedRecording, lsl_config: str) -> None:
        """Write the request for a supervisor.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        state_file.make_folder(self.path)
        for old in (self._stop, self._saved, self.output):
            old.unlink(missing_ok=True)
        state_file.replace(self.lsl_config, lsl_config)
        state_file.replace(self._request, json.dumps(asdict(recording)))

    def requested(self) -> SavedRecording:
        """Return the recording that the supervisor should make."""
        return SavedRecording.read(self._request)

    def save(self, recording: SavedRecording) -> None:
        """Save the state of the recording."""
        state_file.replace(self._saved, json.dumps(asdict(recording)))

    def saved(self) -> SavedRecording | None:
        """Return the state of the last recording; None if it is over and was forgotten."""
        try:
            return SavedRecording.read(self._saved)
        except _DAMAGED:
            return None

    def forget(self) -> None:
        """Delete the state of a recording whose end has been reported."""
        with contextlib.suppress(OSError):
            self._saved.unlink()

    def ask_to_stop(self, *, at_once: bool = False) -> None:
        """Request the end of the recording; *at_once* if its file is discarded.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        state_file.replace(self._stop, _AT_ONCE if at_once else "")

    @property
    def is_asked_to_stop(self) -> bool:
        """Whether an end of the recording was requested."""
        return self._stop.exists()

    @property
    def is_given_up(self) -> bool:
        """Whether its file will be discarded."""
        try:
            return state_file.read(self._stop) == _AT_ONCE
        except OSError:
            return False

    def printed(self) -> str:
        """Return the program's output so far."""
        try:
            return self.output.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""


@dataclass(frozen=True, slots=True)
class WindowRecording:
    """A recording in LabRecorder's window that was started from here."""

    host: str
    port: int
    file: str  # Empty if it cannot be reached from this computer.
    started: float  # Unix time in s.

    def save(self, state: Path) -> str:
        """Save it in the state folder; return the problem, empty on success."""
        try:
            state_file.replace(state / WINDOW_FILE, json.dumps(asdict(self)))
        except OSError as error:
            return (
                f"{state / WINDOW_FILE} cannot be written ({error.strerror or error}): give "
                "`record stop` the file with --file"
            )
        return ""

    @classmethod
    def last(cls, state: Path) -> WindowRecording | None:
        """Return the recording started last in any LabRecorder, unless it is over."""
        try:
            content: dict[str, Any] = json.loads((state / WINDOW_FILE).read_text(encoding="utf-8"))
            host, port = str(content["host"]), int(content["port"])
            return cls(host, port, str(content["file"]), float(content["started"]))
        except _DAMAGED:
            # Without a usable file, it is treated as started by hand.
            return None

    @classmethod
    def last_at(cls, state: Path, host: str, port: int) -> WindowRecording | None:
        """Return the recording started last in this LabRecorder, unless it is over."""
        last = cls.last(state)
        is_same = last and (_canonical(last.host), last.port) == (_canonical(host), port)
        return last if is_same else None

    @staticmethod
    def forget(state: Path) -> None:
        """Delete the saved recording, because it is over."""
        with contextlib.suppress(OSError):
            (state / WINDOW_FILE).unlink()


def _canonical(host: str) -> str:
    """Return one form for all usual names of this computer."""
    lower = host.lower()
    return "localhost" if lower in {"127.0.0.1", "::1"} else lower


def file_going_on(state: Path) -> Path | None:
    """Return the file being recorded, to warn before sensors are changed.

    It is this computer's own recording, or the recording in LabRecorder's window that ``record
    start`` started; None if none is known.
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


def is_going_on(path: Path) -> bool:
    """Whether a file is being recorded, by this computer's recorder or the last window."""
    # Imported here, because `stop` asks this module, too, and needs neither.
    from biosensor_gateway.recording.recorder.recording_file import (  # noqa: PLC0415 - see above
        summarize,
    )
    from biosensor_gateway.settings.places import state_folder  # noqa: PLC0415 - see above

    try:
        state = state_folder()
        file = file_going_on(state)
        if file is None or not path.samefile(file):
            return False
    except (ConfigError, OSError):  # nothing is dropped: no folder or no file, so no recording
        return False
    # A window that was closed by hand tells nobody.
    return RecorderFolder(state).is_running or not summarize(file).is_closed


def require_ended(path: Path) -> None:
    """Check that a file is not being recorded, because what is made of it would lack the rest.

    Raises
    ------
    ConfigError
        ``IN_USE`` if it is.
    """
    if is_going_on(path):
        message = f"{path} is still being recorded; end it first: biosensor-gateway record stop"
        raise ConfigError(ConfigReason.IN_USE, message)


def said_to_go_on(state: Path) -> str:
    """Return a sentence that a recording continues after a program's end; empty if none runs."""
    file = file_going_on(state)
    if file is None:
        return ""
    return f"the recording goes on, to {file}; end and check it: biosensor-gateway record stop"


def lost_by_start(devices: Iterable[DeviceSettings], state: Path) -> str:
    """Return the sensors that a running recording loses if the agent starts with these devices.

    Empty if it loses none, or no recording of this computer runs.
    """
    folder = RecorderFolder(state)
    saved = folder.saved() if folder.is_running else None
    if saved is None:
        return ""
    # Imported here, because `stop` asks this module, too, and needs no settings.
    from biosensor_gateway.devices.registry import declared  # noqa: PLC0415 - see above

    there = {
        naming.source_id(each.identity, stream.data_name)
        for each in devices
        if each.enabled
        for stream in declared(each).streams
    }
    lost = [e for e in saved.required if e not in there and not e.startswith(f"{naming.AGENT}-")]
    if not lost:
        return ""
    sensors = listed(list(dict.fromkeys(each.rpartition("-")[0] for each in lost)))
    return (
        f"a recording goes on, to {saved.file}, and the agent would no longer have {sensors}, with "
        "which it began: nothing more of it is recorded"
    )
