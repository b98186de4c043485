"""A plugin of pytest that runs the tests of one tier and holds unit tests to their rule."""

from __future__ import annotations

import re
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.tiers.guard import GUARD
from tests.tiers.tier import Tier, may_hold, tier_of


def pytest_addoption(parser: pytest.Parser) -> None:
    tiers = [tier.value for tier in Tier]
    parser.addoption("--tier", choices=tiers, help="run only the tests of a tier")


def pytest_configure(config: pytest.Config) -> None:
    GUARD.install()
    if config.getoption("--tier"):
        config.pluginmanager.register(_OneTier(config), "one-tier")


class _OneTier:
    """Leaves out the tests of other tiers, and says at the end that it did."""

    def __init__(self, config: pytest.Config) -> None:
        self._tier = Tier(config.getoption("--tier"))

    def pytest_ignore_collect(self, collection_path: Path) -> bool | None:
        if not re.fullmatch(r"test_.*\.py", collection_path.name):
            return None
        if may_hold(collection_path.read_text(encoding="utf-8"), self._tier):
            return None
        return True

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        others = [item for item in items if tier_of(item) is not self._tier]
        items[:] = [item for item in items if tier_of(item) is self._tier]
        config.hook.pytest_deselected(items=others)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if self._tier is Tier.UNIT:
            terminalreporter.section("not run here")
            terminalreporter.write_line(
                "make check    style, types, documents\n"
                "make seams    each joint of real parts: LSL, ROS, LabRecorder, a browser,"
                " Bluetooth (needs root, and the packages of tests/system/packages.txt)\n"
                "make nightly  everything else: faults, two computers, the Windows installer,"
                " fuzzing, benchmarks (the same needs; hours)"
            )


def _guarded(item: pytest.Item) -> Generator[None, None, None]:
    """Refuse, during a part of a unit test, what units may not use."""
    if tier_of(item) is not Tier.UNIT:
        yield
        return
    GUARD.begin(item.nodeid)
    try:
        yield
    finally:
        refusals = GUARD.end()
        if refusals and sys.exc_info()[0] is None:
            # The tested code has caught the refusal, or it was raised in another thread.
            pytest.fail(refusals[0], pytrace=False)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, None, None]:
    yield from _guarded(item)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    yield from _guarded(item)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, None, None]:
    yield from _guarded(item)
