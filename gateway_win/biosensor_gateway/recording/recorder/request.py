"""Builds the commands that tell LabRecorder where to record, and the path it will use.

It keeps a folder ("study root") and a name below it with placeholders, which it fills
from the fields of its window. A name that is set by remote control is taken in lower
case, unlike what its placeholders stand for. Its own BIDS mode can only be left by
remote control, not entered, so a BIDS name is set as a name with placeholders.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.settings.names import LABEL, require_participant

SUFFIXES = (".xdf", ".xdfz")
MAX_RUN = 1000
"""What the field in its window takes."""


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
                message = (
                    f"{value!r} cannot be the {name} in a file's name: use letters and digits only"
                )
                raise ConfigError(ConfigReason.WRONG_VALUE, message)
        if not 1 <= self.run <= MAX_RUN:
            message = f"--run {self.run} is out of range: LabRecorder counts from 1 to {MAX_RUN}"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)

    @property
    def template(self) -> str:
        """The name with LabRecorder's placeholders."""
        acquisition = "_acq-%a" if self.acquisition else ""
        return f"sub-%p/ses-%s/%m/sub-%p_ses-%s_task-%b{acquisition}_run-%n_%m.xdf"

    @property
    def fields(self) -> dict[str, str]:
        """What the placeholders stand for.

        The run comes last: whenever the task or the modality is set, LabRecorder sets the
        run to the first number that it believes to be free.
        """
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
class Target:
    """Where to record.

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


@dataclass(frozen=True, slots=True)
class Place:
    """What the user says of where to record.

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
    """

    folder: Path | None = None
    recorder_folder: str = ""
    file: Path | None = None
    labels: BidsLabels | None = None


def choose_target(place: Place, *, is_local: bool) -> Target:
    """Work out what to tell LabRecorder, and which file to look for.

    Parameters
    ----------
    place
        What the user says.
    is_local
        Whether LabRecorder runs on this computer.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if that says too little or contradicts itself.
    """
    _require_sense(place, is_local=is_local)
    folder = place.folder.expanduser().absolute() if place.folder else None
    if place.file is not None:
        return _plain(place.file.expanduser(), folder, place.recorder_folder, is_local=is_local)
    root = place.recorder_folder or (str(folder) if folder else "")
    _require_tellable(root)
    if place.labels is None:
        return Target(root, folder=folder)
    files = (folder / place.labels.path,) if folder else ()
    return Target(root, place.labels.template, place.labels.fields, folder, files)


def _plain(file: Path, folder: Path | None, recorder_folder: str, *, is_local: bool) -> Target:
    if file.suffix.lower() not in SUFFIXES or "%" in file.name:
        message = f"--file {file}: the name must end in .xdf and have no '%'"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
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


def _require_sense(place: Place, *, is_local: bool) -> None:
    problem = ""
    if place.file is not None and place.labels is not None:
        problem = "give either --file or a BIDS name (--participant ...), not both"
    elif (
        place.file is not None
        and place.file.is_absolute()
        and not _may_be_absolute(place, is_local=is_local)
    ):
        problem = (
            f"--file {place.file} is a path on this computer; name it relative to --folder or "
            "--recorder-folder"
        )
    elif is_local and place.file is None and place.folder is None:
        problem = (
            "say where to record, else nobody could look whether it does: --file FILE, or "
            "--folder FOLDER, best with --participant"
        )
    if problem:
        raise ConfigError(ConfigReason.WRONG_VALUE, problem)


def _may_be_absolute(place: Place, *, is_local: bool) -> bool:
    return is_local and place.folder is None and not place.recorder_folder


def _require_tellable(text: str) -> None:
    if not text.isprintable() or "{" in text or "}" in text:
        message = f"{text!r} cannot be told to LabRecorder: leave out braces and control characters"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
