"""Tries the network to another computer, which answers, from both sides."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from biosensor_common.doctor.check import AGENT
from biosensor_common.doctor.network_check import judgement
from biosensor_common.doctor.network_check.command import Outcome, check_with
from biosensor_common.doctor.network_check.sides import ANSWER_PORT
from biosensor_common.doctor.report import content
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.doctor.context import read_context
from biosensor_gateway.page.doctor import Examination

HostText = Annotated[str, StringConstraints(min_length=1, max_length=253, pattern=r"^[^\s/]+$")]
CodeText = Annotated[str, StringConstraints(min_length=1, max_length=16)]


class OtherComputer(BaseModel):
    """Which computer is to be asked, and the code that it shows."""

    model_config = ConfigDict(extra="forbid", strict=True)

    host: HostText
    code: CodeText
    port: int = Field(ANSWER_PORT, ge=1024, le=65535)


class NetworkView(Examination):
    """What both computers have found out; of the findings, the cause before what follows from it.

    Attributes
    ----------
    sides
        A line about each computer; none if there was no conversation.
    rows
        What, from there to here, from here to there; the first one has the headings.
    """

    sides: list[str] = Field(default_factory=list[str])
    rows: list[tuple[str, str, str]] = Field(default_factory=list[tuple[str, str, str]])


class NetworkCheck:
    """Runs ``biosensor-gateway doctor --with``, once at a time; parameters as of `Doctor`."""

    def __init__(self, settings: Path, folder: Path) -> None:
        self._settings, self._folder = settings, folder
        self._is_busy = False

    async def check(self, other: OtherComputer) -> NetworkView:
        """Try it, which takes a quarter of a minute.

        Raises
        ------
        ConfigError
            ``IN_USE`` if it is being tried.
        """
        if self._is_busy:
            message = "the network is being tried already; wait for the outcome"
            raise ConfigError(ConfigReason.IN_USE, message)
        self._is_busy = True
        try:
            return network_view(await asyncio.to_thread(self._run, other))
        finally:
            self._is_busy = False

    def _run(self, other: OtherComputer) -> Outcome:
        context = read_context(self._settings, self._folder)
        return check_with(context, AGENT, other.host, other.port, other.code)


def add_network_check(router: APIRouter, check: NetworkCheck) -> None:
    """Add what the page asks of the network."""

    @router.post("/network-check")
    async def try_network(other: OtherComputer) -> NetworkView:
        """Say which of two computers blocks the other's streams, and what opens the way."""
        return await check.check(other)


def network_view(outcome: Outcome) -> NetworkView:
    """Return an outcome as the page shows it."""
    ends = outcome.ends
    return NetworkView(
        **content(outcome.report),
        sides=[] if ends is None else list(judgement.sides_of(*ends)),
        rows=[] if ends is None else list(judgement.rows(*ends)),
    )
