"""The checks of the node's computer inside ``ros2 doctor``, where ros2doctor is installed.

ros2doctor finds the two classes by the entry points ``ros2doctor.checks`` and
``ros2doctor.report`` and calls ``category`` and ``check`` or ``report`` of an instance
(https://github.com/ros2/ros2cli/blob/jazzy/ros2doctor/ros2doctor/api/__init__.py). It asks
for these methods, not for its own base classes; so nothing of it is needed to import this
module, and its results and its way of showing text are fetched when they are wanted.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Protocol, cast

from biosensor_common.doctor.check import NODE, Context, Finding, Level, checks_of
from biosensor_common.doctor.report import Report, printable, run_checks
from lsl_to_ros.doctor import GUIDE

CATEGORY = "biosensors"
"""Links the check with the report for ``ros2 doctor --report-failed``."""
CHECKS = checks_of(NODE)
TITLE = "BIOSENSORS: LSL, DDS AND CLOCKS"
_API, _FORMAT = "ros2doctor.api", "ros2doctor.api.format"


class Result(Protocol):
    """ros2doctor's counters of what is wrong."""

    def add_error(self) -> None:
        """Count an error."""
        ...

    def add_warning(self) -> None:
        """Count a warning."""
        ...


class Items(Protocol):
    """ros2doctor's report: lines with a name each."""

    def add_to_report(self, item_name: str, item_info: str) -> None:
        """Add a line."""
        ...


class BiosensorCheck:
    """Counts and shows the errors and warnings."""

    def category(self) -> str:
        """Return what links it with the report."""
        return CATEGORY

    def check(self) -> Result:
        """Run all checks; what one of them fails with is a warning of its own."""
        result = cast("Result", import_module(_API).Result())
        form = import_module(_FORMAT)
        for finding in examined().findings:
            if finding.level is Level.ERROR:
                form.doctor_error(as_text(finding))
                result.add_error()
            elif finding.level is Level.WARNING:
                form.doctor_warn(as_text(finding))
                result.add_warning()
        return result


class BiosensorReport:
    """Shows all findings, what is right and what is good to know among them."""

    def category(self) -> str:
        """Return what links it with the check."""
        return CATEGORY

    def report(self) -> Items:
        """List the findings in the order of the checks."""
        items = cast("Items", import_module(_API).Report(TITLE))
        for finding in examined().findings:
            items.add_to_report(finding.level.value, as_text(finding))
        return items


@cache
def examined() -> Report:
    """Run the checks; once, though ``--report-failed`` asks for check and report."""
    return run_checks(CHECKS, Context(guide=GUIDE))


def as_text(finding: Finding) -> str:
    """Return what was found, why it matters and the remedy, which may have several lines."""
    lines = [f"{finding.check}: {printable(finding.what)}"]
    if finding.why:
        lines.append(f"    why: {printable(finding.why)}")
    for number, line in enumerate(finding.fix.splitlines()):
        lines.append(f"    {'     ' if number else 'fix: '}{printable(line)}")
    return "\n".join(lines)
