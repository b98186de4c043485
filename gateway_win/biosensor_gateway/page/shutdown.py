"""Ends the page's server when it is asked to, or when nobody needs it any more."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time

from biosensor_gateway.page.models import AgentState
from biosensor_gateway.page.session import Session

_LOOK_S = 0.5
_FIRST_WINDOW_S = 60.0
"""How much longer the first one may take: a browser that has just been installed asks things."""
_GOODBYE_S, _HEARD_S = 1.0, 0.05
"""How long windows have to hear of the end, and how often it is asked whether they have."""


class Shutdown:
    """Ends the server when it is asked to, or when nobody has needed it for a while.

    Parameters
    ----------
    session
        Its windows are told of the end.
    after_s
        How long there must have been neither window nor agent, recording or replay; infinite for a
        server that stays.
    """

    def __init__(self, session: Session, after_s: float = math.inf) -> None:
        self._session = session
        self._after_s = after_s
        self._asked = asyncio.Event()

    def request(self) -> None:
        """End the server soon; what is being answered is answered first."""
        self._asked.set()

    async def run(self) -> None:
        """Wait until the time has come and all windows have heard of it."""
        await self._until_asked_or_not_needed()
        self._session.has_ended = True
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_GOODBYE_S):
                while self._session.traces.screens:  # noqa: ASYNC110 - each leaves by itself
                    await asyncio.sleep(_HEARD_S)

    async def _until_asked_or_not_needed(self) -> None:
        needed = time.monotonic() + _FIRST_WINDOW_S
        opened = 0
        while time.monotonic() - needed < self._after_s:
            # A window may have come and gone since the last look.
            if self._is_needed() or self._session.traces.opened != opened:
                needed = time.monotonic()
                opened = self._session.traces.opened
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._asked.wait(), _LOOK_S)
                return

    def _is_needed(self) -> bool:
        session = self._session
        is_recording = session.recording.is_running or bool(session.recording.busy)
        has_window = bool(session.traces.screens)
        is_going_on = is_recording or session.replay.is_running
        return has_window or is_going_on or session.agent is not AgentState.ABSENT
