"""Answers the network check of another computer, as ``biosensor-gateway doctor --answer`` does."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Generator
from enum import StrEnum, unique
from pathlib import Path

from fastapi import APIRouter
from pydantic import BaseModel, Field

from biosensor_common.doctor.check import AGENT
from biosensor_common.doctor.network_check.command import WayHere, answer_one, way_here
from biosensor_common.doctor.network_check.sides import ANSWER_PORT, Answerer
from biosensor_common.doctor.report import printable
from biosensor_common.errors import ConfigError, ConfigReason, GatewayError
from biosensor_gateway.doctor.context import read_context
from biosensor_gateway.page.network_check import NetworkView, network_view


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


def add_network_answer(router: APIRouter, answer: NetworkAnswer) -> None:
    """Add what the page asks for to answer another computer."""

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


def _waiting(answerer: Answerer, way: WayHere) -> AnswerView:
    return AnswerView(
        state=AnswerState.WAITING,
        code=answerer.code,
        address=way.address,
        port=answerer.port,
        others=list(way.others),
        opening=way.opening,
    )
