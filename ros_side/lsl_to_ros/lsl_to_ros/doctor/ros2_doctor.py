"""Runs the checks of the node's computer inside ``ros2 doctor``, if ros2doctor is installed.

ros2doctor finds the two classes by the entry points ``ros2doctor.checks`` and
``ros2doctor.report`` and calls ``category`` and ``check`` or ``report`` of an instance
(https://github.com/ros2/ros2cli/blob/jazzy/ros2doctor/ros2doctor/api/__init__.py). It requires
these methods, not its own base classes. So this module can be imported without ros2doctor, whose
result and report classes are imported when they are needed.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from biosensor_common.doctor.check import NODE, Context, Finding, Level, checks_of
from biosensor_common.doctor.report import Report, described, run_checks
from lsl_to_ros.doctor import GUIDE

CATEGORY = "biosensors"
"""Links the check with the report for ``ros2 doctor --report-failed``."""
CHECKS = checks_of(NODE)
TITLE = "BIOSENSORS: LSL, DDS AND CLOCKS"
_API, _FORMAT = "ros2doctor.api", "ros2doctor.api.format"


class BiosensorCheck:
    """Counts and prints the errors and warnings."""

    def category(self) -> str:
        """Return the category, which links the check with the report."""
        return CATEGORY

    def check(self) -> Any:  # noqa: ANN401 - a class of ros2doctor, as that of the report
        """Run all checks; a check that fails counts as a warning."""
        result = import_module(_API).Result()
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
    """Reports all findings, including those that are OK."""

    def category(self) -> str:
        """Return the category, which links the report with the check."""
        return CATEGORY

    def report(self) -> Any:  # noqa: ANN401 - see above
        """List the findings in the order of the checks."""
        items = import_module(_API).Report(TITLE)
        for finding in examined().findings:
            items.add_to_report(finding.level.value, as_text(finding))
        return items


@cache
def examined() -> Report:
    """Run the checks once, although ``--report-failed`` requests both check and report."""
    return run_checks(CHECKS, Context(guide=GUIDE))


def as_text(finding: Finding) -> str:
    """Format a finding: what was found, why it matters, and the fix, possibly in several lines."""
    first, *rest = described(finding)
    return "\n".join((first, *(f"    {line}" for line in rest)))
