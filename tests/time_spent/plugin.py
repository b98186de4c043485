"""A plugin of pytest: where the time of a run went, and which files begin or take turns."""

from __future__ import annotations

import os
import tomllib
from collections import defaultdict
from collections.abc import Collection, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling
from xdist.scheduler.protocol import Scheduling

# A plugin of pytest that reports where the time of a run went, and begins with the longest files.

SLOWEST = 30
SHORTEST_S = 0.5
ORDER = Path("tests/time_spent/order.toml")
_BUSY, _FOLDER = "time_spent_busy_s", "time_spent_folder"


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(TimeSpent(config), "time-spent")


class TimeSpent:
    """Measures where tests run, adds up where the run is reported."""

    def __init__(self, config: pytest.Config) -> None:
        self._root = config.rootpath
        self._account = Account()
        order = _order(config.rootpath / ORDER)
        self._longest = order.get("longest", [])
        self._heavy = frozenset(order.get("heavy", []))
        self._busy_s = 0.0

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Begin with what takes longest: else one worker does that at last, and alone."""
        rank = {file: place for place, file in enumerate(self._longest)}

        def place(item: pytest.Item) -> int:
            return rank.get(item.path.relative_to(self._root).as_posix(), len(rank))

        items.sort(key=place)

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_make_scheduler(
        self, config: pytest.Config, log: Producer
    ) -> Scheduling | None:
        if config.getoption("dist") != "loadfile":
            return None
        return TurnsOfTheHeavy(config, log, self._heavy)

    def pytest_runtest_logstart(self) -> None:
        self._busy_s = _busy_s()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        before, self._busy_s = self._busy_s, _busy_s()
        folder = _folder(self._root, item)
        # A worker's reports take these along to where they are added up.
        vars(report).update(
            {_BUSY: self._busy_s - before, _FOLDER: (folder.name, folder.part)},
        )
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        noted: dict[str, Any] = vars(report)
        if _FOLDER in noted:
            folder = Folder(*noted[_FOLDER])
            self._account.add(report.nodeid, folder, report.duration, noted[_BUSY])

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        folders = self._account.folders()
        if not folders:
            return
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
        terminalreporter.section("time spent")
        terminalreporter.write_line(
            f"{os.cpu_count()} processors, load {load:.1f} at the end; "
            "'busy' is the number of processors at work while the tests ran"
        )
        terminalreporter.write_line(f"{'folder':<28}{'tests':>7}{'s':>9}{'busy':>7}")
        for folder, spent in folders.items():
            terminalreporter.write_line(
                f"{folder!s:<28}{spent.tests:>7}{spent.seconds:>9.1f}{spent.busy:>7.2f}"
            )
        slowest = [each for each in self._account.slowest(SLOWEST) if each[1].seconds > SHORTEST_S]
        if slowest:
            terminalreporter.write_line(f"the {len(slowest)} slowest (seconds, busy):")
        for test, spent in slowest:
            terminalreporter.write_line(f"{spent.seconds:>8.1f}{spent.busy:>6.2f}  {test}")


def _order(path: Path) -> dict[str, list[str]]:
    return tomllib.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def _busy_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _folder(root: Path, item: pytest.Item) -> Folder:
    part = ORDINARY if item.get_closest_marker("system") is None else SYSTEM
    folders = item.path.parent.relative_to(root).parts
    return Folder(folders[1] if len(folders) > 1 else item.path.parent.name, part)


# Distributes files to workers so that those that need a processor of their own take turns.
class TurnsOfTheHeavy(LoadFileScheduling):
    """A file's tests stay together, and heavy files are all one worker's.

    Parameters
    ----------
    heavy
        Files, relative to the root.
    """

    def __init__(self, config: pytest.Config, log: Producer, heavy: Collection[str]) -> None:
        super().__init__(config, log)
        self._heavy = heavy

    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return "heavy" if file in self._heavy else file


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
