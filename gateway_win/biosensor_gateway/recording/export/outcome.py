"""Results of exports, and their sentences for users and JSON for scripts."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from biosensor_gateway.recording.export.exporter import Missing
from biosensor_gateway.recording.participants import Mismatch
from biosensor_gateway.recording.xdf.container import Damage
from biosensor_gateway.recording.xdf.report_text import finite, printable


@dataclass(frozen=True, slots=True)
class Written:
    """One written format of a recording."""

    format: str
    path: Path
    size: int
    notes: tuple[str, ...]  # Sentences about what the format could not contain.

    @property
    def is_whole(self) -> bool:
        """Whether it contains all streams that fit the format."""
        return not any(isinstance(each, Missing) for each in self.notes)


@dataclass(frozen=True, slots=True)
class NothingForIt:
    """A format for which the recording has no suitable data."""

    format: str
    why: str  # A sentence for the user.


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of exporting a recording."""

    path: Path
    # Name, source_id and number of samples of the selected streams.
    streams: tuple[tuple[str, str, int], ...]
    written: tuple[Written, ...]
    damages: tuple[Damage, ...]  # Unreadable parts of the recording.
    clock_notes: tuple[str, ...]  # Sentences about the times; `Missing` if samples have none.
    without: tuple[NothingForIt, ...] = ()  # Requested formats that were not written.
    # Set if the recording's name and sensors have different participants and the user has not
    # decided which is right.
    mismatch: Mismatch | None = None

    @property
    def is_certain(self) -> bool:
        """Whether everything was written, and whose data it is is certain."""
        return self.is_whole and self.mismatch is None

    @property
    def is_whole(self) -> bool:
        """Whether every format contains everything that fits it."""
        is_whole = all(each.is_whole for each in self.written)
        is_timed = not any(isinstance(each, Missing) for each in self.clock_notes)
        return is_whole and is_timed and not self.damages and not self.without


_MOST_DAMAGES = 10


def outcome_json(outcome: Outcome) -> str:
    """Return the outcome as JSON."""
    return json.dumps(finite(_content(outcome)), indent=2, allow_nan=False)


def outcomes_json(outcomes: Iterable[Outcome], failed: Iterable[tuple[Path, str]]) -> str:
    """Return the outcomes of several recordings as JSON, with the errors of failed ones."""
    content = {
        "recordings": [_content(each) for each in outcomes],
        "failed": [{"file": str(path), "why": why} for path, why in failed],
    }
    return json.dumps(finite(content), indent=2, allow_nan=False)


def _content(outcome: Outcome) -> dict[str, object]:
    return {
        "file": str(outcome.path),
        "streams": [
            {"name": name, "source_id": source_id, "samples": samples}
            for name, source_id, samples in outcome.streams
        ],
        "damages": [asdict(each) for each in outcome.damages],
        "notes": list(outcome.clock_notes),
        "written": [
            {
                "format": each.format,
                "path": str(each.path),
                "bytes": each.size,
                "notes": list(each.notes),
            }
            for each in outcome.written
        ],
        "without": [asdict(each) for each in outcome.without],
        "mismatch": asdict(outcome.mismatch) if outcome.mismatch else None,
    }


def sentences(outcome: Outcome) -> Iterator[str]:
    """Yield sentences about the recording's damage and what was and was not written."""
    for damage in outcome.damages[:_MOST_DAMAGES]:
        yield f"{outcome.path}: {_damage_text(damage)}"
    more = len(outcome.damages) - _MOST_DAMAGES
    if more > 0:
        yield f"{outcome.path}: {more} more places cannot be read"
    if outcome.mismatch is not None:
        yield (
            f"{printable(outcome.mismatch.sentence)}: the sensors' participant is used; confirm "
            "that with --whose sensors, or use the name's with --whose name"
        )
    yield from map(printable, outcome.clock_notes)
    for each in outcome.written:
        for note in each.notes:
            yield f"{each.format}: {printable(note)}"
        yield f"wrote {each.path} ({_size_text(each.size)})"
    for each in outcome.without:
        yield f"{each.format}: {printable(each.why)}"


def _damage_text(damage: Damage) -> str:
    if damage.breaks_off:
        return f"nothing can be read from byte {damage.start} ({damage.what})"
    return f"bytes {damage.start} to {damage.end} cannot be read ({damage.what})"


def _size_text(size: int) -> str:
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= scale:
            return f"{size / scale:.1f} {unit}"
    return f"{size} bytes"
