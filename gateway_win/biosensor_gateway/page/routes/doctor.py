"""Examines this computer, and the network to another one from both sides."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Generator
from enum import StrEnum, unique
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from biosensor_common.doctor.check import AGENT, checks_of
from biosensor_common.doctor.network_check import diagnosis
from biosensor_common.doctor.network_check.command import (
    Outcome,
    WayHere,
    answer_one,
    check_with,
    way_here,
)
from biosensor_common.doctor.network_check.sides import ANSWER_PORT, Answerer
from biosensor_common.doctor.report import Report, content, printable, run_checks
from biosensor_common.errors import ConfigError, ConfigReason, GatewayError
from biosensor_gateway.doctor.context import read_context
from biosensor_gateway.page.routes.api import OneAtATime
from biosensor_gateway.page.session import Session


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
        self._once = OneAtATime("this computer is being examined already; wait for the outcome")

    async def examine(self) -> Examination:
        """Run all checks, which takes up to some seconds.

        Raises
        ------
        ConfigError
            ``IN_USE`` if an examination goes on.
        """
        with self._once.turn():
            return Examination.model_validate(content(await asyncio.to_thread(self._run)))

    def _run(self) -> Report:
        return run_checks(checks_of(AGENT), read_context(self._settings, self._folder))


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
        self._once = OneAtATime("the network is being tried already; wait for the outcome")

    async def check(self, other: OtherComputer) -> NetworkView:
        """Try it, which takes a quarter of a minute.

        Raises
        ------
        ConfigError
            ``IN_USE`` if it is being tried.
        """
        with self._once.turn():
            return network_view(await asyncio.to_thread(self._run, other))

    def _run(self, other: OtherComputer) -> Outcome:
        context = read_context(self._settings, self._folder)
        return check_with(context, AGENT, other.host, other.port, other.code)


def network_view(outcome: Outcome) -> NetworkView:
    """Return an outcome as the page shows it."""
    ends = outcome.ends
    return NetworkView(
        **content(outcome.report),
        sides=[] if ends is None else list(diagnosis.sides_of(*ends)),
        rows=[] if ends is None else list(diagnosis.rows(*ends)),
    )


@unique
class AnswerState(StrEnum):
    """How far it is."""

    IDLE = "idle"
    """Nobody has asked for it yet."""
    WAITING = "waiting"
    TRYING = "trying"
    """Another computer is there, and both try the network."""
    DONE = "done"
    ENDED = "ended"
    """Nobody has come, it was cancelled, or it did not work."""


class AnswerView(BaseModel):
    """What a person at the other computer needs, and what has come of it.

    Attributes
    ----------
    code, address, port
        What is typed there.
    others
        Network adapters with further addresses, in words.
    opening
        The command that opens the port here, if it is said there that nothing comes back.
    said
        A sentence about each who came and did not get to the end.
    problem
        Why nobody is answered any more.
    outcome
        None until both have tried the network.
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
    """Answers one computer at a time, to whom knows the code.

    Parameters
    ----------
    settings
        The settings file, whether it is there or not.
    folder
        The state folder of the agent.
    port
        TCP port at which it answers; 0 for any that is free.
    """

    def __init__(self, settings: Path, folder: Path, port: int = ANSWER_PORT) -> None:
        self._settings, self._folder, self._port = settings, folder, port
        self._answerer: Answerer | None = None
        self._task: asyncio.Task[None] | None = None
        self._view = AnswerView()

    def view(self) -> AnswerView:
        """Say how far it is."""
        if self._answerer is not None and self._answerer.is_busy:
            return self._view.model_copy(update={"state": AnswerState.TRYING})
        return self._view

    async def start(self) -> AnswerView:
        """Begin to answer, for ten minutes at most.

        Raises
        ------
        ConfigError
            ``IN_USE`` if it goes on.
        TransportError
            ``BUSY`` if another program has the port.
        """
        if self._task is not None and not self._task.done():
            message = "this computer answers already; use the code that it shows, or cancel it"
            raise ConfigError(ConfigReason.IN_USE, message)
        ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._task = asyncio.create_task(self._run(ready))
        await ready
        return self.view()

    async def cancel(self) -> AnswerView:
        """Answer nobody any more; a conversation that goes on comes to its end first."""
        if self._answerer is not None:
            self._answerer.give_up()
            if self._task is not None and not self._answerer.is_busy:
                await asyncio.wait({self._task})
        return self.view()

    async def run(self) -> None:
        """Give up when this is cancelled, so that no thread goes on waiting."""
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
        with Answerer(context, AGENT, self._port) as answerer:
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
    """Add what the page asks of this computer, and of the network between two."""
    doctor = Doctor(session.settings, session.folder)
    check = NetworkCheck(session.settings, session.folder)

    @router.post("/doctor")
    async def examine() -> Examination:
        """Say what is wrong on this computer, and how to fix it."""
        return await doctor.examine()

    @router.post("/network-check")
    async def try_network(other: OtherComputer) -> NetworkView:
        """Say which of two computers blocks the other's streams, and what opens the way."""
        return await check.check(other)

    @router.get("/network-check/answer")
    async def state() -> AnswerView:
        """Say how far the answer is."""
        return answer.view()

    @router.post("/network-check/answer")
    async def start() -> AnswerView:
        """Answer another computer, once, if it knows the code."""
        return await answer.start()

    @router.delete("/network-check/answer")
    async def cancel() -> AnswerView:
        """Answer nobody any more."""
        return await answer.cancel()
