"""Sessions of the clients with the headset, and who gets which stream."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from biosensor_gateway.devices.emotiv_insight.simulator.account import LICENCE_ID, USER
from biosensor_gateway.devices.emotiv_insight.simulator.listener import Client
from biosensor_gateway.devices.emotiv_insight.simulator.warnings import Announcement

WarnOne = Callable[[Client, int, Announcement], None]
"""Tells one client of a warning: its code and message."""

STREAMS_STOPPED, SESSION_CLOSED = 0, 1


@dataclass(eq=False, slots=True)
class Session:
    """One app's session; it ends with the connection that made it.

    Attributes
    ----------
    is_active
        Drawn from the licence; an open session has no EEG.
    subscribers
        Who gets each stream.
    """

    session_id: str
    client_id: str
    client: Client
    started: str
    is_active: bool = False
    subscribers: dict[str, Client] = field(default_factory=dict[str, Client])

    def describe(self, headset: dict[str, Any], status: str = "") -> dict[str, Any]:
        """Return the session object of the API."""
        return {
            "appId": f"com.example.{self.client_id}",
            "headset": headset,
            "id": self.session_id,
            "license": LICENCE_ID if self.is_active else "",
            "owner": USER,
            "recordIds": [],
            "recording": False,
            "started": self.started,
            "status": status or ("activated" if self.is_active else "opened"),
            "stopped": _now() if status == "closed" else "",
            "streams": sorted(self.subscribers),
        }


class Sessions:
    """All sessions of one Cortex.

    Parameters
    ----------
    warn
        Tells a client that its session was closed.
    seed
        Of the session ids.
    """

    def __init__(self, warn: WarnOne, seed: int) -> None:
        self._warn = warn
        self._rng = np.random.default_rng((seed, 0x5E))
        self._sessions: dict[str, Session] = {}

    def __iter__(self) -> Iterator[Session]:
        return iter(tuple(self._sessions.values()))

    def create(self, client_id: str, client: Client) -> Session:
        """Begin an open session."""
        digits = self._rng.bytes(16).hex()
        parts = (digits[:8], digits[8:12], digits[12:16], digits[16:20], digits[20:])
        session = Session("-".join(parts), client_id, client, _now())
        self._sessions[session.session_id] = session
        return session

    def find(self, client_id: str, session_id: str) -> Session | None:
        """Return an app's own session, None if it has no such one."""
        session = self._sessions.get(session_id)
        return session if session is not None and session.client_id == client_id else None

    def of_app(self, client_id: str) -> list[Session]:
        """Return every session of one app."""
        return [session for session in self if session.client_id == client_id]

    def subscribed(self, stream: str) -> list[tuple[Session, Client]]:
        """Return who gets a stream."""
        return [
            (session, session.subscribers[stream])
            for session in self._sessions.values()
            if stream in session.subscribers
        ]

    def close(self, session: Session) -> None:
        """End one session, as its app asked for."""
        self._sessions.pop(session.session_id, None)

    def lose_all(self) -> None:
        """End every session because the headset is gone, and tell the clients."""
        for session in self:
            self.close(session)
            if session.subscribers:
                self._tell(session, STREAMS_STOPPED, "all streams stopped")
            self._tell(session, SESSION_CLOSED, "session closed")

    def end_with(self, client: Client) -> None:
        """End what ends with a connection."""
        for session in self:
            if session.client is client:
                self.close(session)
            for stream, subscriber in tuple(session.subscribers.items()):
                if subscriber is client:
                    del session.subscribers[stream]

    def forget_subscriptions(self) -> None:
        """Send nobody any stream until it subscribes again; all sessions stay."""
        for session in self:
            session.subscribers.clear()

    def forget(self) -> None:
        """Know no session any more."""
        self._sessions.clear()

    def _tell(self, session: Session, code: int, behaviour: str) -> None:
        message = {"behavior": behaviour, "sessionId": session.session_id}
        self._warn(session.client, code, message)


def _now() -> str:
    return datetime.now(tz=UTC).isoformat(timespec="milliseconds")
