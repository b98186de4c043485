"""Names for the files and columns of streams."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from biosensor_gateway.recording.contents.stream import Stream

_UNSAFE = re.compile(r"[^A-Za-z0-9._+-]+")
_LONGEST_NAME = 80


def unique(names: Iterable[str]) -> list[str]:
    """Return names of which none is another's, also where upper case counts for nothing."""
    taken: set[str] = set()
    found: list[str] = []
    for name in names:
        candidate, number = name, 2
        while candidate.casefold() in taken:
            candidate, number = f"{name}_{number}", number + 1
        taken.add(candidate.casefold())
        found.append(candidate)
    return found


def file_names(streams: Sequence[Stream]) -> list[str]:
    """Return a name for a file of each stream, without suffix, that any system can take."""
    plain = (_UNSAFE.sub("_", each.header.name)[:_LONGEST_NAME].strip("._") for each in streams)
    named = zip(plain, streams, strict=True)
    return unique(name or f"stream_{each.number}" for name, each in named)


def numbered(count: int) -> list[str]:
    """Return what tells files of one stream apart; nothing of a single one."""
    return [""] if count == 1 else [f"_{number}" for number in range(1, count + 1)]
