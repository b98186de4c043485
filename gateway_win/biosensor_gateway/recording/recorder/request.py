"""Request of a recording: what to record, to which file, and the errors that refuse it.

LabRecorder keeps a folder ("study root") and a name below it with placeholders, which it fills
from the fields of its window. A name that is set by remote control is taken in lower case, unlike
what its placeholders stand for. Its own BIDS mode can only be left by remote control, not entered,
so a BIDS name is set as a name with placeholders.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, unique
from pathlib import Path
from typing import TYPE_CHECKING

from biosensor_common.errors import ConfigError, ConfigReason, GatewayError
from biosensor_gateway.recording.participants import participant_of
from biosensor_gateway.settings.names import LABEL, require_participant

if TYPE_CHECKING:
    from biosensor_gateway.recording.xdf.verdict import Verdict

SUFFIXES = (".xdf", ".xdfz")
MAX_RUN = 1000
"""What the field in LabRecorder's window takes."""
GROWTH_S = 30.0


@dataclass(frozen=True, slots=True)
class BidsLabels:
    """What a BIDS name is made of; letters and digits only.

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
        """The name with LabRecorder's placeholders."""
        acquisition = "_acq-%a" if self.acquisition else ""
        return f"sub-%p/ses-%s/%m/sub-%p_ses-%s_task-%b{acquisition}_run-%n_%m.xdf"

    @property
    def fields(self) -> dict[str, str]:
        """What the placeholders stand for."""
        # The run comes last: whenever the task or the modality is set, LabRecorder sets the run to
        # the first number that it believes to be free.
        labels = {name: value for name, value in self._labels().items() if value}
        return labels | {"run": str(self.run)}

    @property
    def path(self) -> str:
        """The name as LabRecorder makes it."""
        filled = self.template
        # It writes modalities in lower case, and runs with three digits.
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
    """What to record where, and what to do about what is not as it should be.

    Attributes
    ----------
    folder
        As this computer sees it.
    recorder_folder
        The same in the words of LabRecorder's computer; empty if it calls it the same.
    file
        Name below the folder, or a whole path on this computer.
    labels
        A BIDS name below the folder instead.
    all_streams
        Streams of others are meant to be recorded, too.
    only_ours
        No streams of others: a window refuses if there are some.
    allow_missing
        Start although streams are missing.
    without_away
        Start although sensors of the agent do not stream.
    other_participants
        Start although the file is called after somebody else than who wears the sensors.
    growth_s
        How long the file may take to grow, or all streams to open.
    counts_up
        Whether a BIDS name whose run is taken gets the next one.
    """

    folder: Path | None = None
    recorder_folder: str = ""
    file: Path | None = None
    labels: BidsLabels | None = None
    all_streams: bool = False
    only_ours: bool = False
    allow_missing: bool = False
    without_away: bool = False
    other_participants: bool = False
    growth_s: float = GROWTH_S
    counts_up: bool = True

    @property
    def participant(self) -> str:
        """Whose recording the file will say it is; empty if it says nobody."""
        if self.labels is not None:
            return self.labels.participant
        return "" if self.file is None else participant_of(self.file)


@dataclass(frozen=True, slots=True)
class Target:
    """Where LabRecorder is to record.

    Attributes
    ----------
    root
        Folder in the words of LabRecorder's computer; empty leaves it as it is.
    template, fields
        Name and what its placeholders stand for; empty leaves them as they are.
    folder
        The same folder as this computer sees it; None if it does not.
    files
        Where the file will be, as this computer sees it: one name or, if its case
        is not certain, two. Empty if LabRecorder chooses the name.
    """

    root: str = ""
    template: str = ""
    fields: Mapping[str, str] = field(default_factory=dict[str, str])
    folder: Path | None = None
    files: tuple[Path, ...] = ()

    @property
    def command(self) -> str:
        """The command that tells LabRecorder so; empty if there is nothing to tell."""
        told = {"root": self.root, "template": self.template, **self.fields}
        options = "".join(f"{{{name}:{value}}}" for name, value in told.items() if value)
        return f"filename {options}" if options else ""


def choose_target(request: RecordingRequest, *, is_local: bool) -> Target:
    """Work out what to tell LabRecorder, which may run on this computer, and which file to expect.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if the request says too little or contradicts itself.
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
    """Return the files on this computer that will do, the first best.

    A BIDS name has its run and all after it, unless its run was asked for. In a folder without
    a name, the time is the name.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if the request says too little or contradicts itself.
    """
    if request.recorder_folder:
        raise _wrong("--recorder-folder is for a LabRecorder on another computer; leave it out")
    target = choose_target(request, is_local=True)
    labels, folder = request.labels, target.folder
    if folder is None:
        raise AssertionError("a request of this computer has a folder")
    if request.file is not None:
        # As it was written: only LabRecorder's window makes it lower-case.
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
    # Some version may keep the case; on most file systems of Windows and macOS it is the same.
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
            "say where to record, else nobody could look whether it does: --file FILE, or "
            "--folder FOLDER, best with --participant"
        )


def _require_tellable(text: str) -> None:
    if not text.isprintable() or "{" in text or "}" in text:
        raise _wrong(
            f"{text!r} cannot be told to LabRecorder: leave out braces and control characters"
        )


def _speakable(file: Path) -> Path:
    if file.suffix.lower() != SUFFIXES[0]:
        raise _wrong(f"--file {file}: the name must end in .xdf")
    # It is run in the file's folder, so that only the name must be of such letters.
    if sys.platform == "win32" and not file.name.isascii():
        raise _wrong(
            f"--file {file.name}: on Windows LabRecorder's program takes names of English letters "
            "only; the folder may have any"
        )
    return file


def _wrong(message: str) -> ConfigError:
    return ConfigError(ConfigReason.WRONG_VALUE, message)


@unique
class RecorderReason(Enum):
    """Why a recording was not started, or not ended as it should be."""

    NO_PROGRAM = "no_program"
    """LabRecorder's program is not here."""
    UNREACHABLE = "unreachable"
    """Nothing listens at LabRecorder's remote control, or it went away."""
    NO_REPLY = "no_reply"
    """LabRecorder listens and does not answer: a message in its window waits for a click."""
    REFUSED = "refused"
    """LabRecorder answers something else than ``OK``."""
    RECORDING = "recording"
    """It is recording already."""
    NOT_RECORDING = "not_recording"
    EXISTS = "exists"
    """The file is there already."""
    UNWRITABLE = "unwritable"
    """The file or the state folder cannot be written."""
    STREAMS_MISSING = "streams_missing"
    FOREIGN_STREAMS = "foreign_streams"
    NOT_BEGUN = "not_begun"
    """The program ended, or did not open all streams in time."""
    NO_GROWTH = "no_growth"
    """The file does not come, or does not grow."""
    STILL_GROWING = "still_growing"
    NOT_CLOSED = "not_closed"
    """Nothing is written to the file any more, and it was not closed."""


class RecorderError(GatewayError):
    """A recording was not started, or not ended as it should be."""


class NotClosedError(RecorderError):
    """A recording ended, and its file was not closed.

    Attributes
    ----------
    why
        Why that is, as far as it is known.
    verdict
        What can be said of the file; None if nothing of it can be read.
    """

    def __init__(self, message: str, why: str, verdict: Verdict | None) -> None:
        super().__init__(RecorderReason.NOT_CLOSED, message)
        self.why, self.verdict = why, verdict


class SensorsAwayError(RecorderError):
    """Nobody has confirmed that a recording is to begin without sensors that do not stream.

    Attributes
    ----------
    sentences
        One for each sensor, without a full stop.
    """

    def __init__(self, sentences: Sequence[str]) -> None:
        message = (
            f"{'; '.join(sentences)}. Wait for that with: biosensor-gateway wait-ready, or record "
            "without it with --allow-missing"
        )
        super().__init__(RecorderReason.STREAMS_MISSING, message)
        self.sentences = tuple(sentences)
