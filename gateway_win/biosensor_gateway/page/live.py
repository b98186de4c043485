"""The WebSocket `/live`: traces as binary pictures, everything else as JSON."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from typing import Protocol

from pydantic import BaseModel, ValidationError
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from biosensor_gateway.page.static_files import LIVE
from biosensor_gateway.page.screen import Screen, View
from biosensor_gateway.page.traces import Traces

ENDED = 4000
"""Code with which a WebSocket is closed because somebody has ended the page."""
PICTURES_HZ = 20
STATUS_EVERY = 10
"""Pictures from one status to the next: twice a second."""


def live(source: Source, more: Callable[[], BaseModel]) -> WebSocketRoute:
    """Return the WebSocket.

    Parameters
    ----------
    more
        Says what else the page shows, twice a second.
    """

    async def show(socket: WebSocket) -> None:
        await socket.accept()
        screen = source.traces.open()
        sending = asyncio.create_task(_send(socket, source, screen, more))
        try:
            await _receive(socket, source, screen)
        finally:
            source.traces.close(screen)
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    return WebSocketRoute(LIVE, show)


async def _receive(socket: WebSocket, source: Source, screen: Screen) -> None:
    with contextlib.suppress(WebSocketDisconnect, ValidationError, KeyError):
        # Who asks for something that cannot be shown is not the page, and is let go.
        while True:
            screen.show(View.model_validate_json(await socket.receive_text()), source.now())
    with contextlib.suppress(RuntimeError):
        await socket.close()


async def _send(
    socket: WebSocket, source: Source, screen: Screen, more: Callable[[], BaseModel]
) -> None:
    """Send pictures; a browser that is slow gets fewer of them, and nothing piles up here."""
    count, next_s, told = 0, time.monotonic(), source.turns
    while not source.has_ended:
        if count % STATUS_EVERY == 0 or source.turns != told:
            told = source.turns
            await socket.send_text(more().model_dump_json())
        if screen.is_asked and (picture := screen.picture(source.now())) is not None:
            await socket.send_bytes(picture)
        count += 1
        # What making and sending one takes is not on top; one that is late is not caught up.
        now_s = time.monotonic()
        next_s = max(next_s + 1 / PICTURES_HZ, now_s)
        await asyncio.sleep(next_s - now_s)
    await socket.close(ENDED)


class Source(Protocol):
    """Where the page has its streams from: an agent's memory, or the network.

    Attributes
    ----------
    traces
        What came; the source adds to it.
    has_ended
        Whether somebody has ended the page.
    turns
        How often all has changed, so that nobody who looks should wait for the next status.
    """

    traces: Traces
    has_ended: bool
    turns: int

    def now(self) -> float:
        """Return the LSL time in seconds."""
        ...
