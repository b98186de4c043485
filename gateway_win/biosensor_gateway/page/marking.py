"""Markers of the experimenter: buttons and notes, which the agent sends with its streams."""

from __future__ import annotations

import asyncio
import contextlib
import time
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

    async def mark(self, marker: NewMarker) -> str:
        """Send a marker, stamped with now; say what has become of it.

        Raises
        ------
        GatewayError
            There is no agent, or it refused.
        """
        # A thread may begin late.
        at = self._session.now()
        sent = await self._ask("mark", {**marker.model_dump(), "source": "page", "at": at})
        await self._look()
        said = f"Marked: {marker.note or marker.marker}"
        if not sent.get("received", True):
            return f"{said}, but no program receives it, so it is in no recording."
        return said if self._session.recording.is_running else f"{said}; this page records nothing."

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
        view = MarkersView.model_validate(await self._ask("markers", {}))
        to_unix_s = time.time() - self._session.now()
        for each in view.markers:
            each.time = each.lsl_time + to_unix_s
        self._session.markers = view

    async def _ask(self, command: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        return await asyncio.to_thread(control.ask, self._session.folder, command, arguments)
