"""A request to record, the errors if it is refused, and the results: started, status, stopped.

LabRecorder has a folder ("study root") and a file name template, whose placeholders it fills from
the fields of its window. A template set by remote control is converted to lower case, but the
values of placeholders are not. Remote control can leave LabRecorder's BIDS mode but not enter it,
so a BIDS name is set as a template.

The fields of the results are the same for both recorders, so that a script can read either. In the
``Local`` classes, fields that are always known have narrower types.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, StrEnum, unique
from pathlib import Path
from typing import TYPE_CHECKING

from biosensor_common.errors import ConfigError, ConfigReason, GatewayError
from biosensor_common.naming import LABEL, require_participant
from biosensor_gateway.recording.participants import participant_of
from biosensor_gateway.recording.xdf.findings import Finding, VisibleStream

if TYPE_CHECKING:
    from biosensor_gateway.recording.recorder.live_file import Progress
    from biosensor_gateway.recording.xdf.verdict import Verdict

SUFFIXES = (".xdf", ".xdfz")
MAX_RUN = 1000
"""Limit of the field in LabRecorder's window."""
GROWTH_S = 30.0


@dataclass(frozen=True, slots=True)
class BidsLabels:
    """The parts of a BIDS name; letters and digits only.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if a label has other characters or `run` is out of range.
    """

    participant: str
    session: str = "S001"
    task: str = "Default"
    run: int = 1
    acquisition: str = ""
    modality: str = "beh"

    def __post_init__(self) -> None:
        require_participant(self.participant)
        for name, value in self._labels().items():
            if not LABEL.fullmatch(value) and (value or name != "acquisition"):
                raise _wrong(
                    f"{value!r} cannot be the {name} in a file's name: use letters and digits only"
                )
        if not 1 <= self.run <= MAX_RUN:
            raise _wrong(
                f"--run {self.run} is out of range: LabRecorder counts from 1 to {MAX_RUN}"
            )

    @property
    def template(self) -> str:
        """The file name as a LabRecorder template."""
        acquisition = "_acq-%a" if self.acquisition else ""
        return f"sub-%p/ses-%s/%m/sub-%p_ses-%s_task-%b{acquisition}_run-%n_%m.xdf"

    @property
    def fields(self) -> dict[str, str]:
        """The values of the placeholders."""
        # The run comes last: when the task or the modality is set, LabRecorder resets the run to
        # the first number that it considers free.
        labels = {name: value for name, value in self._labels().items() if value}
        return labels | {"run": str(self.run)}

    @property
    def path(self) -> str:
        """The file name that LabRecorder produces."""
        filled = self.template
        # LabRecorder writes modalities in lower case, and runs with three digits.
        values = {
            "%b": self.task,
            "%p": self.participant,
            "%s": self.session,
            "%a": self.acquisition,
            "%m": self.modality.lower(),
            "%n": f"{self.run:03}",
        }
        for placeholder, value in values.items():
            filled = filled.replace(placeholder, value)
        return filled

    def _labels(self) -> dict[str, str]:
        return {
            "participant": self.participant,
            "session": self.session,
            "acquisition": self.acquisition,
            "modality": self.modality,
            "task": self.task,
        }


@dataclass(frozen=True, slots=True)
class RecordingRequest:
    """The streams to record, the file, and the problems to accept."""

    folder: Path | None = None  # Path on this computer.
    # Path of the same folder on LabRecorder's computer; empty if it is equal.
    recorder_folder: str = ""
    file: Path | None = None  # Name below the folder, or a full path on this computer.
    labels: BidsLabels | None = None
    all_streams: bool = False  # Record other programs' streams without a warning.
    # Record only streams of this agent; LabRecorder's window refuses if there are others.
    only_ours: bool = False
    allow_missing: bool = False  # Start even if streams are missing.
    without_away: bool = False  # Start even if sensors of the agent do not stream.
    # Start even if the file's name has another participant than the sensors.
    other_participants: bool = False
    growth_s: float = GROWTH_S  # Time limit for the file to grow, or for all streams to open.
    counts_up: bool = True  # Whether to use the next run number if the file exists.

    @property
    def participant(self) -> str:
        """The participant in the file's name; empty if there is none."""
        if self.labels is not None:
            return self.labels.participant
        return "" if self.file is None else participant_of(self.file)


@dataclass(frozen=True, slots=True)
class Target:
    """Where LabRecorder should record."""

    root: str = ""  # Path of the folder on LabRecorder's computer; empty keeps the current one.
    # template, fields: file name template and the values of its placeholders; empty keeps the
    # current ones.
    template: str = ""
    fields: Mapping[str, str] = field(default_factory=dict[str, str])
    folder: Path | None = None  # Path of the same folder on this computer; None if not accessible.
    # Possible paths of the file on this computer: one or, if its case is not certain, two. Empty if
    # LabRecorder chooses the name.
    files: tuple[Path, ...] = ()

    @property
    def command(self) -> str:
        """The remote control command for this target; empty if nothing needs to be set."""
        told = {"root": self.root, "template": self.template, **self.fields}
        options = "".join(f"{{{name}:{value}}}" for name, value in told.items() if value)
        return f"filename {options}" if options else ""


def choose_target(request: RecordingRequest, *, is_local: bool) -> Target:
    """Determine the settings for LabRecorder, and which file to expect.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if the request is incomplete or contradictory.
    """
    _require_sense(request, is_local=is_local)
    folder = request.folder.expanduser().absolute() if request.folder else None
    if request.file is not None:
        return _plain(request.file.expanduser(), folder, request.recorder_folder, is_local=is_local)
    root = request.recorder_folder or (str(folder) if folder else "")
    _require_tellable(root)
    if request.labels is None:
        return Target(root, folder=folder)
    files = (folder / request.labels.path,) if folder else ()
    return Target(root, request.labels.template, request.labels.fields, folder, files)


def local_files(request: RecordingRequest) -> Iterator[Path]:
    """Return possible files on this computer, the preferred one first.

    For a BIDS name without an explicit run, the following runs are also possible. With a folder
    only, the name is the current time.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if the request is incomplete or contradictory.
    """
    if request.recorder_folder:
        raise _wrong("--recorder-folder is for a LabRecorder on another computer; leave it out")
    target = choose_target(request, is_local=True)
    labels, folder = request.labels, target.folder
    if folder is None:
        raise AssertionError("a request on this computer needs a folder")
    if request.file is not None:
        # In its original case: only LabRecorder's window converts it to lower case.
        return iter([_speakable(target.files[-1])])
    if labels is None:
        return iter([folder / time.strftime("recording-%Y%m%d-%H%M%S.xdf")])
    runs = range(labels.run, (MAX_RUN if request.counts_up else labels.run) + 1)
    return (folder / replace(labels, run=run).path for run in runs)


def _plain(file: Path, folder: Path | None, recorder_folder: str, *, is_local: bool) -> Target:
    if file.suffix.lower() not in SUFFIXES or "%" in file.name:
        raise _wrong(f"--file {file}: the name must end in .xdf and have no '%'")
    name = file.name.lower()
    _require_tellable(file.name)
    here = (folder or Path()) / file if folder or is_local else None
    if recorder_folder:
        root = "/".join((recorder_folder, *file.parent.parts))
    else:
        root = str(here.parent.absolute()) if here else ""
    _require_tellable(root)
    if here is None:
        return Target(root, name)
    here = here.absolute()
    # Some versions may keep the case; on most Windows and macOS file systems it does not matter.
    files = tuple(dict.fromkeys((here.with_name(name), here)))
    return Target(root, name, {}, here.parent, files)


def _require_sense(request: RecordingRequest, *, is_local: bool) -> None:
    file = request.file
    may_be_absolute = is_local and request.folder is None and not request.recorder_folder
    if file is not None and request.labels is not None:
        raise _wrong("give either --file or a BIDS name (--participant ...), not both")
    if file is not None and file.is_absolute() and not may_be_absolute:
        raise _wrong(
            f"--file {file} is a path on this computer; name it relative to --folder or "
            "--recorder-folder"
        )
    if is_local and file is None and request.folder is None:
        raise _wrong(
            "give the place to record to, so that it can be checked: --file FILE, or --folder "
            "FOLDER, preferably with --participant"
        )


def _require_tellable(text: str) -> None:
    if not text.isprintable() or "{" in text or "}" in text:
        raise _wrong(
            f"{text!r} cannot be sent to LabRecorder: leave out braces and control characters"
        )


def _speakable(file: Path) -> Path:
    if file.suffix.lower() != SUFFIXES[0]:
        raise _wrong(f"--file {file}: the name must end in .xdf")
    # The program runs in the file's folder, so only the file name must be ASCII.
    if sys.platform == "win32" and not file.name.isascii():
        raise _wrong(
            f"--file {file.name}: on Windows, LabRecorder's program accepts only English letters "
            "in names; the folder may have any"
        )
    return file


def _wrong(message: str) -> ConfigError:
    return ConfigError(ConfigReason.WRONG_VALUE, message)


@unique
class RecorderReason(Enum):
    """Why a recording was not started, or not stopped properly."""

    NO_PROGRAM = "no_program"
    """LabRecorder's program is not installed."""
    UNREACHABLE = "unreachable"
    """LabRecorder's remote control does not listen, or has closed the connection."""
    NO_REPLY = "no_reply"
    """LabRecorder listens but does not answer: a message in its window waits for a click."""
    REFUSED = "refused"
    """LabRecorder answers something other than ``OK``."""
    RECORDING = "recording"
    """It is recording already."""
    NOT_RECORDING = "not_recording"
    EXISTS = "exists"
    """The file exists."""
    UNWRITABLE = "unwritable"
    """The file or the state folder cannot be written."""
    OTHER_SESSION = "other_session"
    """The agent sends in another LSL session than the one to be recorded."""
    STREAMS_MISSING = "streams_missing"
    FOREIGN_STREAMS = "foreign_streams"
    NOT_BEGUN = "not_begun"
    """The program ended, or did not open all streams in time."""
    NO_GROWTH = "no_growth"
    """The file is not created or does not grow."""
    STILL_GROWING = "still_growing"
    NOT_CLOSED = "not_closed"
    """The file has stopped growing but was not closed."""


class RecorderError(GatewayError):
    """A recording was not started, or not stopped properly."""


class NotClosedError(RecorderError):
    """A recording ended but its file was not closed.

    Attributes
    ----------
    verdict
        Result of checking the file; None if it cannot be read.
    """

    def __init__(self, message: str, why: str, verdict: Verdict | None) -> None:
        super().__init__(RecorderReason.NOT_CLOSED, message)
        self.why, self.verdict = why, verdict


class SensorsAwayError(RecorderError):
    """Some sensors do not stream, and recording without them was not confirmed."""

    def __init__(self, sentences: Sequence[str]) -> None:
        message = (
            f"{'; '.join(sentences)}. Wait for that with: biosensor-gateway wait-ready, or "
            "record without it using --allow-missing"
        )
        super().__init__(RecorderReason.STREAMS_MISSING, message)
        self.sentences = tuple(sentences)  # One for each sensor, without a full stop.


@unique
class By(StrEnum):
    """Who makes a recording."""

    WINDOW = "window"
    """LabRecorder's window, which cannot be asked."""
    GATEWAY = "gateway"
    """This computer's own recorder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Started:
    """A recording that was started."""

    by: By
    verified: bool  # Whether its file was found growing.
    file: Path | None  # None if this computer cannot access it; then nothing is verified.
    # bytes, took_s: size of the file when found growing, and the time from the command until then.
    bytes: int
    took_s: float
    streams: tuple[VisibleStream, ...]  # Recorded streams, as visible from this computer.
    foreign: tuple[VisibleStream, ...]  # Streams of other programs or agents.
    warnings: tuple[str, ...]
    left_out: tuple[str, ...] = ()  # The warnings about sensors that are not recorded at all.


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalStarted(Started):
    """A recording on this computer that was started."""

    file: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The status of a recording."""

    by: By
    recording: bool | None  # Whether it is running; None if unknown.
    file: Path | None  # None if unknown.
    started: float | None  # Unix time in s; None if unknown.
    # Time since then, without the computer's sleep; None if unknown.
    elapsed_s: float | None = None
    bytes: int = 0
    streams: int = 0
    with_samples: int = 0
    is_closed: bool = False  # Whether every stream has a footer.
    is_local: bool | None = True  # Whether it is made on this computer; None if unknown.
    answers: bool = True
    required: tuple[str, ...] = ()  # source_ids of the streams that it must contain.
    # Contents of the file so far; None if it was not or cannot be read.
    sight: Progress | None = None
    problems: tuple[Finding, ...] = ()  # Problems, the worst first.


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalStatus(Status):
    """The status of a recording on this computer."""

    recording: bool
    file: Path
    started: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Stopped:
    """A recording that was stopped."""

    by: By
    verified: bool  # Whether its file was found closed.
    file: Path | None  # None if unknown or not accessible; then nothing is verified.
    bytes: int = 0
    streams: int = 0
    with_samples: int = 0
    took_s: float = 0.0  # Time from the command until the file was found closed.
    verdict: Verdict | None  # Result of the check; None if it was not checked.
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalStopped(Stopped):
    """A recording on this computer that was stopped."""

    file: Path
    verdict: Verdict
