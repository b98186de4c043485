"""Examines this computer, and the network to another one from both sides."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Generator
from enum import StrEnum, unique
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter
from pydantic import BaseModel, Field, StringConstraints

from biosensor_common.doctor.check import AGENT, checks_of
from biosensor_common.doctor.network_check import (
    Outcome,
    WayHere,
    answer_one,
    check_with,
    diagnosis,
    way_here,
)
from biosensor_common.doctor.network_check.sides import ANSWER_PORT, Answerer
from biosensor_common.doctor.report import Report, content, printable, run_checks
from biosensor_common.errors import ConfigError, ConfigReason, GatewayError
from biosensor_gateway.doctor.context import read_context
from biosensor_gateway.page.models import Body
from biosensor_gateway.page.routes.api import OneAtATime
from biosensor_gateway.page.session import Session


class FindingView(BaseModel):
    """One finding of a check.

    Attributes
    ----------
    category
        Its subject, for people.
    level
        ``ok``, ``note``, ``warning`` or ``error``.
    what, why, fix
        The observation, why it matters, and the exact command or click to fix it; the last two
        are empty if nothing is wrong.
    """

    check: str
    category: str
    level: str
    what: str
    why: str
    fix: str


class Examination(BaseModel):
    """The outcome of ``doctor --json``; see `biosensor_common.doctor.report`.

    Attributes
    ----------
    good
        Whether there are no errors.
    seconds
        Duration of the checks.
    checks
        Names of the checks.
    counts
        Number of findings of each level.
    """

    version: int
    good: bool
    seconds: float
    checks: list[str]
    counts: dict[str, int]
    findings: list[FindingView]


HostText = Annotated[str, StringConstraints(min_length=1, max_length=253, pattern=r"^[^\s/]+$")]
CodeText = Annotated[str, StringConstraints(min_length=1, max_length=16)]


class OtherComputer(Body):
    """The other computer, and the code that it shows."""

    host: HostText
    code: CodeText
    port: int = Field(ANSWER_PORT, ge=1024, le=65535)


class NetworkView(Examination):
    """Outcome of the network check; findings are sorted with causes before consequences."""

    # A line about each computer; empty if they did not connect.
    sides: list[str] = Field(default_factory=list[str])
    # Test, result from there to here, and from here to there; the first row has the headings.
    rows: list[tuple[str, str, str]] = Field(default_factory=list[tuple[str, str, str]])


def network_view(outcome: Outcome) -> NetworkView:
    """Return the page's view of an outcome."""
    ends = outcome.ends
    return NetworkView(
        **content(outcome.report),
        sides=[] if ends is None else list(diagnosis.sides_of(*ends)),
        rows=[] if ends is None else list(diagnosis.rows(*ends)),
    )


@unique
class AnswerState(StrEnum):
    """State of the answering side of the network check."""

    IDLE = "idle"
    """Not started yet."""
    WAITING = "waiting"
    TRYING = "trying"
    """Another computer has connected, and both test the network."""
    DONE = "done"
    ENDED = "ended"
    """No computer has connected, the answer was cancelled, or it failed."""


class AnswerView(BaseModel):
    """What a person has to type at the other computer, and the outcome.

    Attributes
    ----------
    code, address, port
        To type there.
    others
        Network adapters with further addresses, in words.
    opening
        The command that opens the port here, in case the other computer gets no answer.
    said
        A sentence about each connection that was not completed.
    problem
        Why no more computers are answered.
    outcome
        None until both computers have tested the network.
    """

    state: AnswerState = AnswerState.IDLE
    code: str = ""
    address: str = ""
    port: int = 0
    others: list[str] = Field(default_factory=list[str])
    opening: str = ""
    said: list[str] = Field(default_factory=list[str])
    problem: str = ""
    outcome: NetworkView | None = None


class NetworkAnswer:
    """Answers the network check of one other computer, if it has the code."""

    def __init__(self, settings: Path, folder: Path) -> None:
        self._settings, self._folder = settings, folder
        self._answerer: Answerer | None = None
        self._task: asyncio.Task[None] | None = None
        self._view = AnswerView()

    def view(self) -> AnswerView:
        """Return the state of the answer."""
        if self._answerer is not None and self._answerer.is_busy:
            return self._view.model_copy(update={"state": AnswerState.TRYING})
        return self._view

    async def start(self) -> AnswerView:
        """Begin to answer, for at most ten minutes.

        Raises
        ------
        ConfigError
            ``IN_USE`` if it answers already.
        TransportError
            ``BUSY`` if another program has the port.
        """
        if self._task is not None and not self._task.done():
            message = "this computer is already answering; use the code that it shows, or cancel"
            raise ConfigError(ConfigReason.IN_USE, message)
        ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._task = asyncio.create_task(self._run(ready))
        await ready
        return self.view()

    async def cancel(self) -> AnswerView:
        """Stop answering, after a check that is running."""
        if self._answerer is not None:
            self._answerer.give_up()
            if self._task is not None and not self._answerer.is_busy:
                await asyncio.wait({self._task})
        return self.view()

    async def run(self) -> None:
        """Wait until cancelled, then end the thread that waits for another computer."""
        try:
            await asyncio.Event().wait()
        finally:
            if self._answerer is not None:
                self._answerer.give_up()

    async def _run(self, ready: asyncio.Future[None]) -> None:
        with contextlib.ExitStack() as stack:
            try:
                answerer, way = await asyncio.to_thread(stack.enter_context, self._opened())
            except GatewayError as error:
                ready.set_exception(error)
                return
            self._answerer = answerer
            self._view = view = _waiting(answerer, way)
            ready.set_result(None)

            def say(sentence: str) -> None:
                view.said.append(printable(sentence))

            try:
                outcome = await asyncio.to_thread(answer_one, answerer, say)
                update = {"state": AnswerState.DONE, "outcome": network_view(outcome)}
            except GatewayError as error:
                update = {"state": AnswerState.ENDED, "problem": str(error)}
            self._view = view.model_copy(update=update)

    @contextlib.contextmanager
    def _opened(self) -> Generator[tuple[Answerer, WayHere]]:
        context = read_context(self._settings, self._folder)
        with Answerer(context, AGENT, ANSWER_PORT) as answerer:
            yield answerer, way_here(context, answerer.port)


def _waiting(answerer: Answerer, way: WayHere) -> AnswerView:
    return AnswerView(
        state=AnswerState.WAITING,
        code=answerer.code,
        address=way.address,
        port=answerer.port,
        others=list(way.others),
        opening=way.opening,
    )


def add_doctor(router: APIRouter, session: Session, answer: NetworkAnswer) -> None:
    """Add the routes of the checks of this computer and of the network."""
    here = OneAtATime("this computer is already being checked; wait for the result")
    network = OneAtATime("the network is already being tested; wait for the result")

    @router.post("/doctor")
    async def examine() -> Examination:
        """Check this computer; return what is wrong, and how to fix it."""

        def run() -> Report:
            return run_checks(checks_of(AGENT), read_context(session.settings, session.folder))

        with here.turn():
            return Examination.model_validate(content(await asyncio.to_thread(run)))

    @router.post("/network-check")
    async def try_network(other: OtherComputer) -> NetworkView:
        """Check which of two computers blocks the other's streams, and how to open the way."""

        def run() -> Outcome:
            context = read_context(session.settings, session.folder)
            return check_with(context, AGENT, other.host, other.port, other.code)

        with network.turn():
            return network_view(await asyncio.to_thread(run))

    @router.get("/network-check/answer")
    async def state() -> AnswerView:
        """Return the state of the answer to another computer."""
        return answer.view()

    @router.post("/network-check/answer")
    async def start() -> AnswerView:
        """Answer another computer, once, if it knows the code."""
        return await answer.start()

    @router.delete("/network-check/answer")
    async def cancel() -> AnswerView:
        """Stop answering other computers."""
        return await answer.cancel()
