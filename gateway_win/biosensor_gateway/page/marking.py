"""Markers of the experimenter: buttons and notes, which the agent sends with its streams."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping
from typing import Any

from biosensor_common.errors import GatewayError
from biosensor_gateway.agent import control
from biosensor_gateway.page.marker_models import MarkersView, NewMarker
from biosensor_gateway.page.session import Session

LOOK_S = 1.0


class Marking:
    """Sends markers, and keeps the newest of them for the page.

    Parameters
    ----------
    session
        Its `markers` is kept up to date.
    """

    def __init__(self, session: Session) -> None:
        self._session = session

    async def run(self) -> None:
        """Ask the agent for its markers every second, until cancelled."""
        while True:
            if self._session.has_agent:
                with contextlib.suppress(GatewayError):
                    await self._look()
            await asyncio.sleep(LOOK_S)

    async def mark(self, marker: NewMarker) -> None:
        """Send a marker, stamped with now.

        Raises
        ------
        GatewayError
            There is no agent, or it refused.
        """
        # A thread may begin late.
        at = self._session.now()
        await self._ask("mark", {**marker.model_dump(), "source": "page", "at": at})
        await self._look()

    async def undo(self, number: int | None) -> None:
        """Say that a marker was a mistake; nothing is deleted.

        Raises
        ------
        GatewayError
            There is no agent, or it refused.
        """
        await self._ask("undo-marker", {} if number is None else {"id": number})
        await self._look()

    async def _look(self) -> None:
        self._session.markers = MarkersView.model_validate(await self._ask("markers", {}))

    async def _ask(self, command: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        return await asyncio.to_thread(control.ask, self._session.folder, command, arguments)
