"""Determines the BIDS kind of a stream, names folders and files, and writes text and JSON files."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto, unique
from pathlib import Path
from typing import TypeVar

from biosensor_common.naming import label
from biosensor_common.quantities import ContentType
from biosensor_gateway.recording.contents.stream import Stream

# Includes types of other programs; https://github.com/sccn/xdf/wiki/MoCap-Meta-Data.
_MOTION_TYPES: Mapping[str, str] = {
    ContentType.ACCELEROMETER.lower(): "ACCEL",
    "accelerometry": "ACCEL",
    "acceleration": "ACCEL",
    "acc": "ACCEL",
    "gyroscope": "GYRO",
    "gyro": "GYRO",
    "magnetometer": "MAGN",
    ContentType.MOCAP.lower(): "MISC",
    "imu": "MISC",
}
Key = TypeVar("Key", bound=Hashable)
NOTHING = "n/a"
"""BIDS notation for a missing value."""


@unique
class Kind(Enum):
    """Kinds of signals for which BIDS has separate folders or sidecars."""

    EEG = auto()
    EMG = auto()
    GAZE = auto()
    MOTION = auto()
    OTHER = auto()


_BY_TYPE: Mapping[str, Kind] = {
    "eeg": Kind.EEG,
    "emg": Kind.EMG,
    **dict.fromkeys(("gaze", "eyetracking", "eyetracker", "eyetrack"), Kind.GAZE),
    **dict.fromkeys(_MOTION_TYPES, Kind.MOTION),
}


def kind_of(stream: Stream) -> Kind:
    """Return the kind of a stream; case, spaces, hyphens and underscores are ignored."""
    return _BY_TYPE.get(_plain(stream), Kind.OTHER)


def motion_type(stream: Stream) -> str:
    """Return the usual BIDS channel type of a motion stream."""
    return _MOTION_TYPES[_plain(stream)]


def _plain(stream: Stream) -> str:
    return "".join(each for each in stream.header.content_type.lower() if each.isalnum())


def labels(names: Mapping[Key, Sequence[str]]) -> dict[Key, str]:
    """Return a unique label for each key, ignoring case.

    Parameters
    ----------
    names
        Names of each key, from the usual one to more specific ones.

    Returns
    -------
    dict
        The usual name as a label; where it is not unique, a more specific name or a number.
    """
    result: dict[Key, str] = {}
    for length in range(1, max((len(each) for each in names.values()), default=0) + 1):
        tried = {key: label("".join(names[key][:length])) for key in names if key not in result}
        claims = Counter(each.lower() for each in tried.values())
        taken = {each.lower() for each in result.values()}
        result |= {
            key: found
            for key, found in tried.items()
            if claims[found.lower()] == 1 and found.lower() not in taken
        }
    taken = {each.lower() for each in result.values()}
    for key, parts in names.items():
        if key not in result:
            result[key] = _numbered(label("".join(parts)), taken)
    return result


def _numbered(plain: str, taken: set[str]) -> str:
    number = 1
    while (found := f"{plain}n{number}").lower() in taken:
        number += 1
    taken.add(found.lower())
    return found


@dataclass(frozen=True, slots=True)
class Entities:
    """The entities shared by the file names of one recording.

    Attributes
    ----------
    subject, session, task, acquisition, run
        Labels; empty where there is none, except `subject` and `task`.
    """

    subject: str
    task: str
    session: str = ""
    acquisition: str = ""
    run: str = ""

    def of(self, subject: str) -> Entities:
        """Return the same entities for another participant."""
        return replace(self, subject=subject)

    def path(self, datatype: str, suffix: str, **more: str) -> Path:
        """Return a file's path in the dataset.

        Parameters
        ----------
        datatype
            The folder, ``beh`` or ``motion``.
        suffix
            With file extension: ``physio.tsv.gz``.
        more
            ``tracksys`` or ``recording``, if this file has it.
        """
        named = {
            "sub": self.subject,
            "ses": self.session,
            "task": self.task,
            "tracksys": more.get("tracksys", ""),
            "acq": self.acquisition,
            "run": self.run,
            "recording": more.get("recording", ""),
        }
        name = "_".join(f"{key}-{value}" for key, value in named.items() if value)
        folders = [f"{key}-{named[key]}" for key in ("sub", "ses") if named[key]]
        return Path(*folders, datatype, f"{name}_{suffix}")


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write a sidecar.

    Raises
    ------
    OSError
        If it exists or cannot be written.
    """
    write_text(path, json.dumps(content, indent=2, ensure_ascii=False) + "\n")


def write_rows(path: Path, rows: Iterable[Sequence[str]]) -> None:
    """Write a small table with its column names first; see :func:`line`.

    Raises
    ------
    OSError
        If it exists or cannot be written.
    """
    write_text(path, "".join(map(line, rows)))


def write_text(path: Path, text: str) -> None:
    """Write a text with unchanged line ends.

    Raises
    ------
    OSError
        If it exists or cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # Headers and texts may contain unpaired surrogates.
    with path.open("x", encoding="utf-8", errors="replace", newline="\n") as file:
        file.write(text)


def line(cells: Sequence[str]) -> str:
    """Return a row of a table, without empty cells and without tabs or line ends in cells."""
    return "\t".join(map(cell, cells)) + "\n"


def cell(text: str) -> str:
    """Return text as one cell of a table."""
    clean = "".join(each if each.isprintable() else " " for each in text)
    clean = " ".join(clean.split()) or NOTHING
    # Behind a quote that is left open, pandas and R would take the next rows for the same cell.
    return '"' + clean.replace('"', '""') + '"' if clean.startswith('"') else clean
