"""Starts and ends the agent; *Quit* ends the page, and what runs if that is wanted, too."""

from __future__ import annotations

import asyncio
from typing import Literal

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.agent.stopping import stop_agent
from biosensor_gateway.page.models import AgentState, Outcome, StatusView
from biosensor_gateway.page.routes.devices import (
    asked,
    started,
)
from biosensor_gateway.page.routes.recording import Recorder
from biosensor_gateway.page.session import Session, Shutdown


def add_agent(router: APIRouter, session: Session) -> None:
    """Add how the agent is, begins and ends."""

    @router.get("/status")
    async def status() -> StatusView:
        """Say how the agent and its devices are."""
        return session.status()

    @router.post("/agent/start")
    async def start() -> Outcome:
        """Start the agent with the devices of the settings."""
        if not any(each.enabled for each in session.configured()):
            message = "the settings name no device yet; add one first"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        return started(session, virtual=False)

    @router.post("/agent/try")
    async def start_virtual() -> Outcome:
        """Start the agent with virtual devices of every kind."""
        return started(session, virtual=True)

    @router.post("/agent/stop")
    async def stop() -> Outcome:
        """End the agent; every stream ends with it."""
        await asked(session, "stop", {})
        return Outcome(sentence="The agent has been told to end.")


_LOOK_S = 0.2


class Quitting(BaseModel):
    """What becomes of the agent, and of a recording: they end, too, or go on."""

    model_config = ConfigDict(extra="forbid", strict=True)

    rest: Literal["end", "leave"]


def add_quit(router: APIRouter, session: Session, recorder: Recorder, shutdown: Shutdown) -> None:
    """Add `/api/v1/quit`."""

    @router.post("/quit")
    async def leave(quitting: Quitting) -> Outcome:
        """End the page; first the recording and the agent, if they are to end."""
        said = await _end_the_rest(session, recorder) if quitting.rest == "end" else _left(session)
        shutdown.request()
        return Outcome(sentence=" ".join(said))


async def _end_the_rest(session: Session, recorder: Recorder) -> list[str]:
    """End first what must not lose its streams; return what came of each."""
    said: list[str] = []
    if session.recording.is_running:
        said.append((await recorder.stop()).sentence)
    while session.agent is AgentState.STARTING and not is_held(session.folder):  # noqa: ASYNC110 - of another process
        # It cannot be told to end before it is there.
        await asyncio.sleep(_LOOK_S)
    try:
        await asyncio.to_thread(stop_agent, session.folder)
    except TransportError as error:
        if error.reason is not TransportReason.ABSENT:
            raise
    else:
        said.append("The agent has ended.")
    return said


def _left(session: Session) -> list[str]:
    said: list[str] = []
    if session.agent is not AgentState.ABSENT:
        said.append("The agent streams on.")
    if session.recording.is_running:
        said.append("The recording goes on.")
    return said
