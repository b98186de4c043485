"""Examines this computer: what is wrong, why it matters and what mends it."""

from __future__ import annotations

import asyncio
from pathlib import Path

from fastapi import APIRouter
from pydantic import BaseModel

from biosensor_common.doctor.check import AGENT, checks_of
from biosensor_common.doctor.report import Report, content, run_checks
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.doctor.context import read_context


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


class Examination(BaseModel):
    """What ``doctor --json`` says; see `biosensor_common.doctor.report`.

    Attributes
    ----------
    good
        There are no errors.
    seconds
        How long it took.
    checks
        What was to be looked at.
    counts
        How many findings there are of each level.
    """

    version: int
    good: bool
    seconds: float
    checks: list[str]
    counts: dict[str, int]
    findings: list[FindingView]


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

    async def examine(self) -> Examination:
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
            return Examination.model_validate(content(await asyncio.to_thread(self._run)))
        finally:
            self._is_busy = False

    def _run(self) -> Report:
        return run_checks(checks_of(AGENT), read_context(self._settings, self._folder))


def add_doctor(router: APIRouter, doctor: Doctor) -> None:
    """Add what the page asks a doctor."""

    @router.post("/doctor")
    async def examine() -> Examination:
        """Say what is wrong on this computer, and how to mend it."""
        return await doctor.examine()
