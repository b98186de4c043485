"""Formats the results of exports, as sentences for users and as JSON for scripts."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path

from biosensor_gateway.recording.export.outcome import Outcome
from biosensor_gateway.recording.xdf.container import Damage
from biosensor_gateway.recording.xdf.printing import finite, printable

_MOST_DAMAGES = 10


def as_json(outcome: Outcome) -> str:
    """Return the outcome as JSON."""
    return json.dumps(finite(_content(outcome)), indent=2, allow_nan=False)


def all_as_json(outcomes: Iterable[Outcome], failed: Iterable[tuple[Path, str]]) -> str:
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
            f"{printable(outcome.mismatch.sentence)}: it is written as the sensors say; confirm "
            "that with --whose sensors, or take the name with --whose name"
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
        return f"nothing can be read from byte {damage.start} on ({damage.what})"
    return f"bytes {damage.start} to {damage.end} cannot be read ({damage.what})"


def _size_text(size: int) -> str:
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= scale:
            return f"{size / scale:.1f} {unit}"
    return f"{size} bytes"
