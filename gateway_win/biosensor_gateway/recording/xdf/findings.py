"""Findings about a recording, and how bad each is."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum, unique
from pathlib import Path

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.participants import compare_file


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


@unique
class About(StrEnum):
    """What a finding is about, in the order in which findings are told."""

    PERSONS = "persons"
    """Data of persons, and the recording as a whole."""
    OTHERS = "others"
    """Streams of other programs."""
    OURSELVES = "ourselves"
    """What the agent and the node record of themselves: counters and events."""


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
    about: About = About.PERSONS

    def of(self, about: About) -> Finding:
        """Return the same about something; what we record of ourselves spoils nobody's data."""
        milder = _MILDER if about is About.OURSELVES else {}
        return replace(self, about=about, level=milder.get(self.level, self.level))


def other_participants(
    path: Path, identities: Iterable[DeviceIdentity | None]
) -> Iterator[Finding]:
    """Say whether a recording is called after somebody else than those who wear its sensors."""
    mismatch = compare_file(path, identities)
    if mismatch is not None:
        level = Level.ERROR if mismatch.is_all else Level.WARNING
        yield Finding(level, "other-participants", "", mismatch.sentence)


_MILDER = {Level.ERROR: Level.WARNING, Level.WARNING: Level.NOTE}


def in_order(findings: Iterable[Finding]) -> list[Finding]:
    """Sort by what they are about, and then the worst first; else the order stays."""
    subjects, levels = list(About), list(Level)
    return sorted(findings, key=lambda each: (subjects.index(each.about), levels.index(each.level)))
