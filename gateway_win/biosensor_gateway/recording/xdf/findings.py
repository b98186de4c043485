"""Findings about a recording, and how bad each is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum, unique


@unique
class Level(StrEnum):
    """How bad a finding is.

    ``ERROR``: something is wrong or missing in the file. ``WARNING``: the file is
    right, and something happened that whoever analyses it must know. ``NOTE``: good
    to know.
    """

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Finding:
    """One sentence about a recording.

    Attributes
    ----------
    code
        What it is about, for scripts.
    stream
        Name of the stream, empty if it is about the whole file.
    """

    level: Level
    code: str
    stream: str
    text: str
