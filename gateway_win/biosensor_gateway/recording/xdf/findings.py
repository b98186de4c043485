"""Findings about a recording, and how bad each is."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum, unique
from pathlib import Path

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.participants import compare_file


@unique
class Level(StrEnum):
    """How bad a finding is.

    ``ERROR``: something is wrong or missing in the file. ``WARNING``: the file is intact, but
    something happened that matters for the analysis. ``NOTE``: for information.
    """

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@unique
class About(StrEnum):
    """What a finding is about, in the order of the report."""

    PERSONS = "persons"
    """Data of participants, and the recording as a whole."""
    OTHERS = "others"
    """Streams of other programs."""
    OURSELVES = "ourselves"
    """The agent's and the node's own streams: counters and events."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One sentence about a recording."""

    level: Level
    code: str  # Identifier for scripts.
    stream: str  # Name of the stream; empty for the whole file.
    text: str
    about: About = About.PERSONS
    # Text of the finding about the event of which this one is a consequence.
    part_of: str = ""

    def of(self, about: About) -> Finding:
        """Return a copy about this subject; about our own streams, with a milder level."""
        milder = _MILDER if about is About.OURSELVES else {}
        return replace(self, about=about, level=milder.get(self.level, self.level))


@dataclass(frozen=True, slots=True, order=True)
class VisibleStream:
    """A stream that this computer sees."""

    name: str
    source_id: str
    host: str

    @property
    def title(self) -> str:
        """Its name in LabRecorder's list."""
        return f"{self.name} ({self.host})"


_MOST_NAMED = 5
CLOCK_SET_S = 0.5
"""Least step of a computer's clock that is reported."""


def unreported(
    steps: Iterable[tuple[float, Finding]], reported_s: Sequence[float]
) -> Iterator[Finding]:
    """Yield findings on steps of this computer's clock, unless events of an agent report the same.

    Parameters
    ----------
    steps
        The size of each in s, and its finding. An error tells more than that there was a step.
    reported_s
        Sizes of the steps that events report.
    """
    for by_s, finding in steps:
        is_reported = any(abs(by_s - each) < CLOCK_SET_S for each in reported_s)
        if finding.level is Level.ERROR or not is_reported:
            yield finding


def late_streams(
    late: Sequence[VisibleStream], recorded: Collection[tuple[str, str]]
) -> Iterator[Finding]:
    """Report streams that appeared after the recording began, as recorders search only then.

    Parameters
    ----------
    recorded
        Names and source_ids of the streams in the file.
    """
    missing = [each for each in late if (each.name, each.source_id) not in recorded]
    if not missing:
        return
    named = ", ".join(each.title for each in missing[:_MOST_NAMED])
    named += f" and {len(missing) - _MOST_NAMED} more" if len(missing) > _MOST_NAMED else ""
    what = "is not in it: start its program" if len(missing) == 1 else "are not in it: start such"
    what += "" if len(missing) == 1 else " programs"
    text = f"{named} appeared after the recording began, and {what} first, then record"
    yield Finding(Level.WARNING, "late-stream", "", text, About.OTHERS)


def other_participants(
    path: Path, identities: Iterable[DeviceIdentity | None]
) -> Iterator[Finding]:
    """Report if the file name and its sensors have different participants."""
    mismatch = compare_file(path, identities)
    if mismatch is not None:
        level = Level.ERROR if mismatch.is_all else Level.WARNING
        yield Finding(level, "other-participants", "", mismatch.sentence)


_MILDER = {Level.ERROR: Level.WARNING, Level.WARNING: Level.NOTE}


def by_event(findings: Sequence[Finding]) -> list[tuple[Finding, list[Finding]]]:
    """Return each finding that is not a consequence of another one, with its consequences."""
    heads = {each.text: each for each in reversed(findings) if not each.part_of}
    parts: dict[str, list[Finding]] = {text: [] for text in heads}
    for each in findings:
        # That the agent was restarted is said once, not again for each stream.
        if each.part_of and each.code != heads.get(each.part_of, each).code:
            parts[each.part_of].append(each)
    return [
        (each, parts[each.text] if heads.get(each.text) is each else [])
        for each in findings
        if each.part_of not in heads
    ]


def in_order(findings: Iterable[Finding]) -> list[Finding]:
    """Sort by subject, then by severity with the worst first; the sort is stable."""
    subjects, levels = list(About), list(Level)
    return sorted(findings, key=lambda each: (subjects.index(each.about), levels.index(each.level)))
