"""Seconds by test and by folder, and what they may come to."""

from __future__ import annotations

import tomllib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

FAILS_ABOVE = 3.0
"""Times its budget from which a folder fails a run that holds it.

A machine on which others work, too, made the same folders take up to twice as long; a limit
within that would fail for the machine, and whoever saw that would just run it again.
"""
SYSTEM = "system"
ORDINARY = "test"


@dataclass(slots=True)
class Spent:
    """Seconds, how many of them a processor worked for it, and by how many tests."""

    seconds: float = 0.0
    busy_s: float = 0.0
    tests: int = 0

    @property
    def busy(self) -> float:
        """Processors that it kept busy on average: of 0.1, many fit side by side."""
        return self.busy_s / self.seconds if self.seconds else 0.0


@dataclass(frozen=True, slots=True, order=True)
class Folder:
    """A folder directly below ``tests``; its system tests run apart and count apart."""

    name: str
    part: str = ORDINARY

    def __str__(self) -> str:
        return f"{self.name} ({SYSTEM})" if self.part == SYSTEM else self.name


class Account:
    """What each test has taken: set-up, the test itself and what ended with it."""

    def __init__(self) -> None:
        self._tests: dict[str, tuple[Folder, Spent]] = {}

    def add(self, test: str, folder: Folder, seconds: float, busy_s: float) -> None:
        """Count a part of a test."""
        _, spent = self._tests.setdefault(test, (folder, Spent(tests=1)))
        spent.seconds += seconds
        spent.busy_s += busy_s

    def folders(self) -> dict[Folder, Spent]:
        """Sums, the longest first."""
        sums: dict[Folder, Spent] = defaultdict(Spent)
        for folder, spent in self._tests.values():
            of_folder = sums[folder]
            of_folder.seconds += spent.seconds
            of_folder.busy_s += spent.busy_s
            of_folder.tests += spent.tests
        return dict(sorted(sums.items(), key=lambda item: -item[1].seconds))

    def slowest(self, most: int) -> list[tuple[str, Spent]]:
        """The tests that took longest."""
        tests = sorted(self._tests.items(), key=lambda item: -item[1][1].seconds)
        return [(test, spent) for test, (_, spent) in tests[:most]]


class Budget:
    """Seconds that folders may take.

    Parameters
    ----------
    seconds
        By folder; one that is not there may take any time.
    longest
        Files of tests that take minutes, as paths; a run begins with them.
    heavy
        Those of which no two may run at a time.
    """

    def __init__(
        self, seconds: dict[Folder, float], longest: Sequence[str] = (), heavy: Sequence[str] = ()
    ) -> None:
        self._seconds = seconds
        self.longest = tuple(longest)
        self.heavy = frozenset(heavy)

    @classmethod
    def read(cls, path: Path) -> Budget:
        """Read a file with the tables ``test`` and ``system``; without it, nothing is limited."""
        if not path.exists():
            return cls({})
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        seconds = {
            Folder(name, part): float(limit)
            for part in (ORDINARY, SYSTEM)
            for name, limit in content.get(part, {}).items()
        }
        # A sensor says in its folder what it emits; who adds one need not touch this file.
        for sensor in path.parent.glob("*/streams.json"):
            seconds.setdefault(Folder(sensor.parent.name, ORDINARY), float(content["sensor"]))
        return cls(seconds, content.get("longest", ()), content.get("heavy", ()))

    @property
    def folders(self) -> set[Folder]:
        """Those that have one."""
        return set(self._seconds)

    def of(self, folder: Folder) -> float | None:
        """Seconds of a folder, None if it has no budget."""
        return self._seconds.get(folder)

    def exceeded(self, folders: dict[Folder, Spent], times: float = 1.0) -> dict[Folder, float]:
        """Return the folders that took more than so many times their budget, with that budget."""
        return {
            folder: seconds
            for folder, spent in folders.items()
            if (seconds := self.of(folder)) is not None and spent.seconds > times * seconds
        }
