"""Runs checks side by side; none of them can stop the others or the program."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from biosensor_common.doctor.check import Check
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, Level, warning

_UNKNOWN = "What it would have found is unknown."
_ON_A_BUSY_COMPUTER = 3
"""So many times as long is waited where several checks are late: then they hold each other up."""


@dataclass(frozen=True, slots=True)
class Report:
    """All findings, in the order of the checks.

    Attributes
    ----------
    checks
        What was to be looked at.
    seconds
        How long it took.
    """

    checks: tuple[Check, ...]
    findings: tuple[Finding, ...]
    seconds: float

    @property
    def is_good(self) -> bool:
        """Whether there are no errors."""
        return all(finding.level is not Level.ERROR for finding in self.findings)


def run_checks(checks: Sequence[Check], context: Context) -> Report:
    """Run checks at once, each for as long as it may take.

    A check that raises, or has not ended in time, has a finding that says so, behind what it
    has found until then. One that hangs goes on in a daemon thread until the program ends.
    """
    begun = time.monotonic()
    running = [_Running(check, context) for check in checks]
    late = [each for each in running if not each.has_ended(begun)]
    if len(late) > 1:
        for each in late:
            each.has_ended(begun, _ON_A_BUSY_COMPUTER)
    findings = [finding for each in running for finding in each.result()]
    return Report(tuple(checks), tuple(findings), time.monotonic() - begun)


class _Running:
    """A check in its thread."""

    def __init__(self, check: Check, context: Context) -> None:
        self._check = check
        self._alone = context.guide.alone.format(check=check.name)
        self._findings: list[Finding] = []
        self._waited_s = 0.0
        self._thread = threading.Thread(
            target=self._run, args=(context,), name=f"doctor-{check.name}", daemon=True
        )
        self._thread.start()

    def has_ended(self, begun: float, times_as_long: int = 1) -> bool:
        """Wait until the check ends or its time is over; return whether it has ended."""
        self._waited_s = times_as_long * self._check.limit_s
        self._thread.join(max(0.0, begun + self._waited_s - time.monotonic()))
        return not self._thread.is_alive()

    def result(self) -> list[Finding]:
        """Return what the check has found by now."""
        is_late = self._thread.is_alive()
        found = self._findings.copy()
        if is_late:
            what = f"the check did not end within {self._waited_s:g} s"
            found.append(warning(what, _UNKNOWN, self._alone))
        return [self._check.mark(each) for each in found]

    def _run(self, context: Context) -> None:
        try:
            for finding in self._check.load()(context):
                self._findings.append(finding)
        except BaseException as problem:  # noqa: BLE001 - a check may fail in any way, also by sys.exit
            what = f"the check failed: {type(problem).__name__}: {problem}"
            self._findings.append(warning(what, _UNKNOWN, self._alone))
