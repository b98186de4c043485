"""The first half of what is loaded while the server runs already: what the page shows."""

from __future__ import annotations

import asyncio
import contextlib
import math
from pathlib import Path

from starlette.routing import Router

from biosensor_gateway.page.link import AgentLink
from biosensor_gateway.page.live import live
from biosensor_gateway.page.session import Session
from biosensor_gateway.page.shutdown import Shutdown

_FIRST_S = 1.5


class Service:
    """Shows the agent, its devices and what they measure.

    Parameters
    ----------
    folder
        The state folder of the agent.
    settings
        The settings file.
    end_after_s
        See `Shutdown`.

    Attributes
    ----------
    session
    shutdown
    live
        The application of the WebSocket.
    """

    def __init__(self, folder: Path, settings: Path, end_after_s: float = math.inf) -> None:
        self.session = session = Session(folder, settings)
        self.shutdown = Shutdown(session, end_after_s)
        self.live = Router([live(session, session.status)])

    async def shown(self) -> None:
        """Wait until a browser was told what there is; not long, for there may be none."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_FIRST_S):
                await self.session.told.wait()

    async def run(self) -> None:
        """Follow the agent until cancelled."""
        session = self.session
        link = AgentLink(
            session.folder, session.take_status, session.traces.take, session.take_dropped
        )
        await link.run()
