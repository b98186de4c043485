"""*Quit* of the page: ends its server, and what runs if that is wanted, too."""

from __future__ import annotations

import asyncio
from typing import Literal

from fastapi import APIRouter, FastAPI
from pydantic import BaseModel, ConfigDict

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.agent.stopping import stop_agent
from biosensor_gateway.page.static_files import PREFIX
from biosensor_gateway.page.models import AgentState, Outcome, Problem
from biosensor_gateway.page.routes.recording import Recorder
from biosensor_gateway.page.session import Session
from biosensor_gateway.page.shutdown import Shutdown

_LOOK_S = 0.2


class Quitting(BaseModel):
    """What becomes of the agent, and of a recording: they end, too, or go on."""

    model_config = ConfigDict(extra="forbid", strict=True)

    rest: Literal["end", "leave"]


def add_quit(app: FastAPI, session: Session, recorder: Recorder, shutdown: Shutdown) -> None:
    """Add `/api/v1/quit`."""
    router = APIRouter(prefix=PREFIX, responses={400: {"model": Problem}})

    @router.post("/quit")
    async def leave(quitting: Quitting) -> Outcome:
        """End the page; first the recording and the agent, if they are to end."""
        said = await _end_the_rest(session, recorder) if quitting.rest == "end" else _left(session)
        shutdown.request()
        return Outcome(sentence=" ".join(said))

    app.include_router(router)


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
