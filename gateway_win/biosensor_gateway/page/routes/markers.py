"""Markers of the experimenter: buttons and notes, which the agent sends with its streams."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Mapping
from typing import Any, Literal

from fastapi import APIRouter

from biosensor_common.errors import GatewayError
from biosensor_gateway.agent import control
from biosensor_gateway.agent.marker_commands import LISTED
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.page.models import (
    Body,
    MarkersView,
    MarkerView,
    Outcome,
)
from biosensor_gateway.page.session import Session
from biosensor_gateway.settings import editor


class NewMarker(Body):
    """A marker of the experimenter: a button, or a note."""

    marker: str
    note: str = ""
    kind: Literal["button", "note"] = "button"


class MarkerButtons(Body):
    """The names of the buttons, in their order."""

    buttons: list[str]


class MarkerNumber(Body):
    """Identifies a marker; without a number, the last that is not undone."""

    id: int | None = None


def add_markers(router: APIRouter, marking: Marking) -> None:
    """Add the routes that send, undo and name markers."""

    @router.post("/markers")
    async def mark(marker: NewMarker) -> Outcome:
        """Send a marker, stamped with the current time."""
        return Outcome(sentence=await marking.mark(marker))

    @router.put("/markers/buttons")
    async def name_buttons(wanted: MarkerButtons) -> Outcome:
        """Name the buttons of markers in the settings."""
        return Outcome(sentence=await marking.name_buttons(wanted))

    @router.post("/markers/undo")
    async def undo(which: MarkerNumber) -> Outcome:
        """Undo a marker: it is marked as a mistake, and not deleted."""
        await marking.undo(which.id)
        return Outcome(sentence="The marker is marked as a mistake; it stays in the recording.")


LOOK_S = 1.0


class Marking:
    """Sends markers, and stores the newest for the page.

    Parameters
    ----------
    session
        Its `markers` is kept up to date.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._turns = session.turns
        self._begun = 0.0
        self._of_before: list[MarkerView] = []

    async def run(self) -> None:
        """Ask the agent for its markers every second, until cancelled."""
        while True:
            if self._session.has_agent:
                with contextlib.suppress(GatewayError):
                    await self._look()
            await asyncio.sleep(LOOK_S)

    async def mark(self, marker: NewMarker) -> str:
        """Send a marker, stamped with the current time; return the outcome.

        Raises
        ------
        GatewayError
            If there is no agent, or it refuses.
        """
        # Taken here, because the thread that sends it may start late.
        at = self._session.now()
        sent = await self._ask("mark", {**marker.model_dump(), "source": "page", "at": at})
        await self._look()
        said = f"Marked: {marker.note or marker.marker}"
        if not sent.get("received", True):
            return f"{said}, but no program receives it, so it is in no recording."
        return (
            said if self._session.recording.is_running else f"{said}; this page is not recording."
        )

    async def undo(self, number: int | None) -> None:
        """Announce that a marker does not count; the marker itself stays in recordings.

        Raises
        ------
        GatewayError
            If there is no agent, or it refuses.
        """
        await self._ask("undo-marker", {} if number is None else {"id": number})
        await self._look()

    async def name_buttons(self, wanted: MarkerButtons) -> str:
        """Write the names of the buttons to the settings, and apply them to the agent.

        Raises
        ------
        GatewayError
            If the settings or the agent refuse them.
        """
        editor.set_marker_buttons(self._session.settings, settings_models(), wanted.buttons)
        if self._session.has_agent:
            await self._ask("reload", {})
            await self._look()
        return "The buttons now have these names."

    async def _look(self) -> None:
        view = MarkersView.model_validate(await self._ask("markers", {}))
        to_unix_s = time.time() - self._session.now()
        for each in view.markers:
            each.time = each.lsl_time + to_unix_s
        if self._turns != self._session.turns:
            # A new agent does not have the old markers, and numbers its own from the start.
            self._turns = self._session.turns
            known = {(each.id, each.lsl_time) for each in view.markers}
            before = self._session.markers.markers
            self._of_before = [e for e in before if (e.id, e.lsl_time) not in known][-LISTED:]
        self._begun = max(self._begun, self._session.recording.started)
        gone = len(self._of_before)
        view.markers, view.told = [*self._of_before, *view.markers], True
        for number, each in enumerate(view.markers):
            each.earlier = (each.time or 0.0) < self._begun
            each.can_be_undone = number >= gone and not each.earlier
        self._session.markers = view

    async def _ask(self, command: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        return await asyncio.to_thread(control.ask, self._session.folder, command, arguments)
