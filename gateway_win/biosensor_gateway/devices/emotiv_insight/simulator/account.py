"""User, apps, licence and sessions of a virtual Cortex, and its errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import Flag, IntEnum, auto
from typing import Any, NamedTuple

import numpy as np

from biosensor_gateway.devices.emotiv_insight.simulator.listener import Client


class Code(IntEnum):
    """Error codes of the API."""

    NO_HEADSET = -32001
    WRONG_LICENCE = -32002
    HEADSET_UNAVAILABLE = -32004
    SESSION_EXISTS = -32005
    NO_LICENCE = -32006
    NO_SESSION = -32007
    INVALID_TOKEN = -32014
    EXPIRED_TOKEN = -32015
    NO_STREAM = -32016
    WRONG_CREDENTIALS = -32021
    NOT_LOGGED_IN = -32033
    STARTING = -32122
    INVALID_REQUEST = -32600
    UNKNOWN_METHOD = -32601
    INVALID_PARAMS = -32602
    INTERNAL = -32603
    PARSE = -32700


_MESSAGES = {
    Code.NO_HEADSET: "No headset is connected.",
    Code.WRONG_LICENCE: "Invalid License Key.",
    Code.HEADSET_UNAVAILABLE: "The headset is not available.",
    Code.SESSION_EXISTS: "There is a session with this headset.",
    Code.NO_LICENCE: "There is no valid licence for an active session.",
    Code.NO_SESSION: "There is no such session.",
    Code.INVALID_TOKEN: "The token is invalid.",
    Code.EXPIRED_TOKEN: "The token has expired.",
    Code.NO_STREAM: "The stream is unavailable or unsupported.",
    Code.WRONG_CREDENTIALS: "The client id or secret is wrong.",
    Code.NOT_LOGGED_IN: "Nobody is logged in.",
    Code.STARTING: "Cortex is starting.",
    Code.INVALID_REQUEST: "No request.",
    Code.PARSE: "This is no JSON.",
}


class RpcError(Exception):
    """A request fails with an error, by default with the usual message for its code."""

    def __init__(self, code: int, message: str = "") -> None:
        super().__init__(message)
        self.code = int(code)
        self._message = message

    def described(self) -> dict[str, Any]:
        """Return the error object of the API."""
        usual = _MESSAGES.get(Code(self.code)) if self.code in set(Code) else None
        message = self._message or usual or "The request has failed."
        return {"code": self.code, "message": message}


LICENCE_ID = "0b5a2f7e-virtual-licence"
USER = "virtual_user"


class Licence(Flag):
    """What the user's licence covers."""

    NONE = 0
    """No licence: no session can be activated."""
    EEG = auto()
    METRICS = auto()

    @property
    def scopes(self) -> list[str]:
        """Names as in ``getLicenseInfo``."""
        return [name for flag, name in ((self.EEG, "eeg"), (self.METRICS, "pm")) if flag in self]


class App(NamedTuple):
    """A registered application with its credentials."""

    client_id: str
    client_secret: str


@dataclass(slots=True)
class _Token:
    client_id: str
    is_expired: bool = False


class Account:
    """The user's account on this computer, who is logged in and has approved the app.

    Parameters
    ----------
    app
        The registered app.
    """

    def __init__(self, app: App, seed: int) -> None:
        self.is_logged_in = True
        self.licence = Licence.EEG | Licence.METRICS
        self._app = app
        self._tokens: dict[str, _Token] = {}
        self._rng = np.random.default_rng((seed, 0xC0))

    def logins(self) -> list[dict[str, str]]:
        """Return the list of logged-in users, with at most one entry."""
        if not self.is_logged_in:
            return []
        return [
            {
                "currentOSUId": "1000",
                "currentOSUsername": "participant",
                "lastLoginTime": "2026-01-05T03:00:00.000+01:00",
                "loggedInOSUId": "1000",
                "loggedInOSUsername": "participant",
                "username": USER,
            }
        ]

    def identify(self, params: Mapping[str, Any]) -> str:
        """Check an app's credentials; return its client id.

        Raises
        ------
        RpcError
            If they are wrong or no user is logged in.
        """
        client_id, secret = params["clientId"], params["clientSecret"]
        if self._app != (client_id, secret):
            raise RpcError(Code.WRONG_CREDENTIALS)
        self._need_login()
        return client_id

    def authorize(self, client_id: str, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return a token for the app."""
        if params.get("license", LICENCE_ID) != LICENCE_ID:
            raise RpcError(Code.WRONG_LICENCE)
        token = ".".join(self._rng.bytes(12).hex() for _ in range(3))
        self._tokens[token] = _Token(client_id)
        return {"cortexToken": token}

    def owner(self, params: Mapping[str, Any]) -> str:
        """Return the client id of the app with a request's token.

        Raises
        ------
        RpcError
            If the token is unknown or expired, or no user is logged in.
        """
        token = self._tokens.get(params["cortexToken"])
        if token is None:
            raise RpcError(Code.INVALID_TOKEN)
        if token.is_expired:
            raise RpcError(Code.EXPIRED_TOKEN)
        self._need_login()
        return token.client_id

    def activate(self) -> None:
        """Raise RpcError if there is no licence for an active session."""
        if self.licence is Licence.NONE:
            raise RpcError(Code.NO_LICENCE)

    def expire_tokens(self) -> None:
        """Expire all tokens."""
        for token in self._tokens.values():
            token.is_expired = True

    def forget_tokens(self) -> None:
        """Forget all tokens."""
        self._tokens.clear()

    def licence_info(self) -> dict[str, Any]:
        """Return the result of ``getLicenseInfo``."""
        return {
            "isOnline": True,
            "license": {
                "licenseId": LICENCE_ID,
                "scopes": self.licence.scopes,
                "expired": False,
                "localQuota": 0,
                "sessionCount": {"count": 0, "debit": 0},
            },
        }

    def _need_login(self) -> None:
        if not self.is_logged_in:
            raise RpcError(Code.NOT_LOGGED_IN)


@dataclass(eq=False, slots=True)
class Session:
    """One app's session; it ends with the connection that created it."""

    session_id: str
    client_id: str
    client: Client
    started: str
    is_active: bool = False  # Whether it uses the licence; a session that is only open has no EEG.
    # Subscribed clients of each stream.
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
    """All sessions of one Cortex."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng((seed, 0x5E))
        self._sessions: dict[str, Session] = {}

    def __iter__(self) -> Iterator[Session]:
        return iter(tuple(self._sessions.values()))

    def create(self, client_id: str, client: Client) -> Session:
        """Create an open session."""
        digits = self._rng.bytes(16).hex()
        parts = (digits[:8], digits[8:12], digits[12:16], digits[16:20], digits[20:])
        session = Session("-".join(parts), client_id, client, _now())
        self._sessions[session.session_id] = session
        return session

    def find(self, client_id: str, session_id: str) -> Session | None:
        """Return an app's session; None if it does not have it."""
        session = self._sessions.get(session_id)
        return session if session is not None and session.client_id == client_id else None

    def of_app(self, client_id: str) -> list[Session]:
        """Return all sessions of one app."""
        return [session for session in self if session.client_id == client_id]

    def subscribed(self, stream: str) -> list[tuple[Session, Client]]:
        """Return the sessions and clients subscribed to a stream."""
        return [
            (session, session.subscribers[stream])
            for session in self._sessions.values()
            if stream in session.subscribers
        ]

    def close(self, session: Session) -> None:
        """End one session on request of its app."""
        self._sessions.pop(session.session_id, None)

    def end_with(self, client: Client) -> None:
        """End the sessions and subscriptions of a closed connection."""
        for session in self:
            if session.client is client:
                self.close(session)
            for stream, subscriber in tuple(session.subscribers.items()):
                if subscriber is client:
                    del session.subscribers[stream]

    def forget_subscriptions(self, _: float = 0.0) -> None:
        """Forget all subscriptions but keep the sessions."""
        for session in self:
            session.subscribers.clear()

    def forget(self) -> None:
        """Forget all sessions."""
        self._sessions.clear()


def _now() -> str:
    return datetime.now(tz=UTC).isoformat(timespec="milliseconds")
