"""Names for the files and columns of streams."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from biosensor_gateway.recording.contents.stream import Stream

_UNSAFE = re.compile(r"[^A-Za-z0-9._+-]+")
_LONGEST_NAME = 80
# Device names, which are reserved on Windows with any suffix.
_OF_WINDOWS = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)


def unique(names: Iterable[str]) -> list[str]:
    """Return names made unique, ignoring case."""
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
    """Creates file names for streams, without suffix, that are valid on any system.

    All names are unique, also between runs and other streams, and even if case is ignored.

    Parameters
    ----------
    reserved
        Names of other files, which streams must not use.
    """

    def __init__(self, reserved: Iterable[str] = ()) -> None:
        self._taken = {each.casefold() for each in reserved}

    def of(self, stream: Stream, runs: int = 1) -> list[str]:
        """Return a name for each run of a stream."""
        # Many commands would take a leading hyphen as an option.
        plain = _UNSAFE.sub("_", stream.header.name)[:_LONGEST_NAME].strip("._-")
        name = plain or f"stream_{stream.number}"
        if _OF_WINDOWS.fullmatch(name):
            name = f"{name}_"
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
    """Return the name without a run, which stays reserved, and the names of the runs."""
    return [name] if runs == 1 else [name, *(f"{name}_run{each}" for each in range(1, runs + 1))]


def file_names(streams: Sequence[Stream], reserved: Iterable[str] = ()) -> list[str]:
    """Return a file name for each stream, see `FileNames`."""
    names = FileNames(reserved)
    return [names.of(each)[0] for each in streams]
