"""Seconds by test and by folder."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

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
