"""Examines this computer: what is wrong, why it matters and what mends it."""

from __future__ import annotations

import asyncio
from pathlib import Path

from fastapi import APIRouter
from pydantic import BaseModel, Field

from biosensor_common.doctor.finding import Finding
from biosensor_common.doctor.runner import Report, run_checks
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.doctor.context import read_context
from biosensor_gateway.doctor.table import CHECKS


class FindingView(BaseModel):
    """One thing that was looked at.

    Attributes
    ----------
    category
        What it is about, in words for people.
    level
        ``ok``, ``note``, ``warning`` or ``error``.
    what, why, fix
        What is the case, why it matters, and the exact command or click; the last two are
        empty if all is well.
    """

    check: str
    category: str
    level: str
    what: str
    why: str
    fix: str


class ExaminationView(BaseModel):
    """What an examination of this computer has found; the worst first.

    Attributes
    ----------
    is_good
        There are no errors.
    seconds
        How long it took.
    """

    is_good: bool
    seconds: float
    findings: list[FindingView] = Field(default_factory=list[FindingView])


class Doctor:
    """Runs the checks of ``biosensor-gateway doctor``, once at a time.

    Parameters
    ----------
    settings
        The settings file, whether it is there or not.
    folder
        The state folder of the agent.
    """

    def __init__(self, settings: Path, folder: Path) -> None:
        self._settings, self._folder = settings, folder
        self._is_busy = False

    async def examine(self) -> ExaminationView:
        """Run all checks, which takes up to some seconds.

        Raises
        ------
        ConfigError
            ``IN_USE`` if an examination goes on.
        """
        if self._is_busy:
            message = "this computer is being examined already; wait for the outcome"
            raise ConfigError(ConfigReason.IN_USE, message)
        self._is_busy = True
        try:
            return _view(await asyncio.to_thread(self._run))
        finally:
            self._is_busy = False

    def _run(self) -> Report:
        return run_checks(CHECKS, read_context(self._settings, self._folder))


def add_doctor(router: APIRouter, doctor: Doctor) -> None:
    """Add what the page asks a doctor."""

    @router.post("/doctor")
    async def examine() -> ExaminationView:
        """Say what is wrong on this computer, and how to mend it."""
        return await doctor.examine()


def _view(report: Report) -> ExaminationView:
    order = ("error", "warning", "note", "ok")
    categories = {check.name: check.category.value for check in report.checks}
    worst_first = sorted(report.findings, key=lambda each: order.index(each.level.value))
    return ExaminationView(
        is_good=report.is_good,
        seconds=round(report.seconds, 3),
        findings=[finding_view(each, categories[each.check]) for each in worst_first],
    )


def finding_view(finding: Finding, category: str) -> FindingView:
    """Return a finding as the page shows it."""
    return FindingView(
        check=finding.check,
        category=category,
        level=finding.level.value,
        what=finding.what,
        why=finding.why,
        fix=finding.fix,
    )
