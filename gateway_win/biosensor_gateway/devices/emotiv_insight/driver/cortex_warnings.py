"""Hands on what Cortex says unasked, and keeps secrets out of what is shown of it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Generator

import structlog

from biosensor_gateway.devices.emotiv_insight.driver.codes import Event
from biosensor_gateway.devices.emotiv_insight.driver.messages import Warned

KEPT_WARNINGS = 64
_LOGGED_UNKNOWN = 8
_LONGEST_SHOWN = 200

_log = structlog.get_logger("biosensor_gateway.emotiv_insight")


class Warnings:
    """The warnings of one connection, for the log and for those who wait for one."""

    def __init__(self) -> None:
        self._watches: list[tuple[frozenset[Event], asyncio.Queue[Warned]]] = []
        self._hidden: set[str] = set()
        self._unknown_codes: set[int] = set()

    def hide(self, text: str) -> None:
        """Keep a secret out of errors and logs, should Cortex quote it."""
        if text:
            self._hidden.add(text)

    def watch(self, *events: Event) -> asyncio.Queue[Warned]:
        """Put such warnings, from now on, into the queue that is returned."""
        queue: asyncio.Queue[Warned] = asyncio.Queue()
        self._watches.append((frozenset(events), queue))
        return queue

    @contextlib.contextmanager
    def watching(self, *events: Event) -> Generator[asyncio.Queue[Warned]]:
        """Do the same for as long as the block lasts."""
        queue = self.watch(*events)
        try:
            yield queue
        finally:
            self._watches = [each for each in self._watches if each[1] is not queue]

    def tell(self, warned: Warned) -> None:
        """Log a warning, and put it into the queues of those who wait for its kind."""
        self._log_warning(warned)
        for events, queue in self._watches:
            if warned.event in events and queue.qsize() < KEPT_WARNINGS:
                queue.put_nowait(warned)

    def _log_warning(self, warned: Warned) -> None:
        if warned.event is Event.UNKNOWN:
            # A flood of them must not fill the log.
            if warned.code in self._unknown_codes or len(self._unknown_codes) >= _LOGGED_UNKNOWN:
                return
            self._unknown_codes.add(warned.code)
        text = self.shown(warned.text)
        people = f"the Emotiv program says: {text or warned.event.value}"
        _log.info(
            "Cortex tells",
            event_name=warned.event.value,
            code=warned.code,
            text=text,
            for_people=people,
        )

    def shown(self, text: str) -> str:
        """Return a text of Cortex without secrets, in one line, not too long."""
        for hidden in self._hidden:
            text = text.replace(hidden, "***")
        return " ".join(text.split())[:_LONGEST_SHOWN]
