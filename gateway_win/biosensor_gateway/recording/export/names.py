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


class FileNames:
    """Names the files of streams, without suffix, so that any system can take them.

    No two are the same, neither of streams of one name nor of a run and another stream, also
    where upper case counts for nothing.
    """

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def of(self, stream: Stream, runs: int = 1) -> list[str]:
        """Return a name for each run of a stream."""
        plain = _UNSAFE.sub("_", stream.header.name)[:_LONGEST_NAME].strip("._")
        name = plain or f"stream_{stream.number}"
        candidate, number = name, 2
        while not self._take(names := _of_runs(candidate, runs)):
            candidate, number = f"{name}_{number}", number + 1
        return names[1:] if runs > 1 else names

    def _take(self, names: Iterable[str]) -> bool:
        claimed = {each.casefold() for each in names}
        is_free = self._taken.isdisjoint(claimed)
        if is_free:
            self._taken |= claimed
        return is_free


def _of_runs(name: str, runs: int) -> list[str]:
    """Return the name without a run, which no other stream is to have, and those of the runs."""
    return [name] if runs == 1 else [name, *(f"{name}_run{each}" for each in range(1, runs + 1))]


def file_names(streams: Sequence[Stream]) -> list[str]:
    """Return a name for the file of each stream, see `FileNames`."""
    names = FileNames()
    return [names.of(each)[0] for each in streams]
