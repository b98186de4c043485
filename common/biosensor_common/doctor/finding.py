"""A finding: what was found, how bad it is, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum, unique


@unique
class Level(StrEnum):
    """How bad a finding is.

    ``OK``: looked at, and right. ``NOTE``: good to know before a study. ``WARNING``: it
    works, but something will go wrong in a case that is named. ``ERROR``: it does not work.
    """

    OK = "ok"
    NOTE = "note"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that a check looked at.

    Attributes
    ----------
    what
        What is the case, one sentence or less.
    why
        Why it matters; empty if all is well.
    fix
        The exact command or click; empty if all is well.
    check
        Name of the check; the runner fills it in.

    Raises
    ------
    ValueError
        If something that is not right comes without a reason or a remedy.
    """

    level: Level
    what: str
    why: str = ""
    fix: str = ""
    check: str = ""

    def __post_init__(self) -> None:
        if self.level is not Level.OK and not (self.why and self.fix):
            raise ValueError(f"{self.what!r}: say why it matters and how to mend it")


def ok(what: str) -> Finding:
    """Return what is right."""
    return Finding(Level.OK, what)


def note(what: str, why: str, fix: str) -> Finding:
    """Return what is good to know."""
    return Finding(Level.NOTE, what, why, fix)


def warning(what: str, why: str, fix: str) -> Finding:
    """Return what will go wrong in a case that is named."""
    return Finding(Level.WARNING, what, why, fix)


def error(what: str, why: str, fix: str) -> Finding:
    """Return what does not work."""
    return Finding(Level.ERROR, what, why, fix)
