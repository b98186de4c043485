"""Figures of the scenarios, and their table at the end of the report."""

from __future__ import annotations

import pytest

from tests.faults.scenarios.figures import NAME, FigureTable, Record, recorder

_TABLE = pytest.StashKey[FigureTable]()


class _Collector:
    """Sees the report of each test, wherever it ran."""

    def __init__(self, table: FigureTable) -> None:
        self._table = table

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        # The last of a test's three reports has the figures of all of it.
        if report.when == "teardown":
            self._table.collect(report.user_properties)


def pytest_configure(config: pytest.Config) -> None:
    table = config.stash[_TABLE] = FigureTable()
    config.pluginmanager.register(_Collector(table))


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, exitstatus: int, config: pytest.Config
) -> None:
    del exitstatus
    table = config.stash.get(_TABLE, None)
    if table:
        folder = config.rootpath / "build"
        table.write(folder)
        terminalreporter.section("figures of the fault suite")
        terminalreporter.write_line(table.markdown())
        terminalreporter.write_line(f"Also: {folder / NAME}.json")


@pytest.fixture
def figures(request: pytest.FixtureRequest) -> Record:
    """Record a figure by ``figures(fault, what, target, measured)``."""
    return recorder(request.node.user_properties)
