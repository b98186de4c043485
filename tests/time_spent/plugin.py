"""A plugin of pytest: where the time of a run went, and which files begin or take turns."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Collection, Generator
from pathlib import Path
from typing import Any

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling
from xdist.scheduler.protocol import Scheduling

from tests.time_spent.account import ORDINARY, SYSTEM, Account, Folder

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
