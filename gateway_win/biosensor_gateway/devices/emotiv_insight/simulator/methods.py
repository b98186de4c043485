"""The methods of the API."""

from __future__ import annotations

import fnmatch
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import Flag, IntEnum, auto
from typing import Any, NamedTuple

import numpy as np

from biosensor_gateway.devices.emotiv_insight.simulator.headset import (
    Announcement,
    Headset,
    Release,
    Status,
)
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
    SESSION_LIMIT = -32019
    WRONG_CREDENTIALS = -32021
    NOT_LOGGED_IN = -32033
    NO_ACCESS_RIGHT = -32102
    STARTING = -32122
    INVALID_REQUEST = -32600
    UNKNOWN_METHOD = -32601
    INVALID_PARAMS = -32602
    INTERNAL = -32603
    PARSE = -32700


class RpcError(Exception):
    """A request that is answered with an error.

    Parameters
    ----------
    code, message
        As they go over the wire.
    """

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = int(code)
        self.message = message


LICENCE_ID = "0b5a2f7e-virtual-licence"
USER = "virtual_user"


class Licence(Flag):
    """What the user's licence covers."""

    NONE = 0
    """No licence at all: no session can be activated."""
    EEG = auto()
    METRICS = auto()

    @property
    def scopes(self) -> list[str]:
        """Names as ``getLicenseInfo`` has them."""
        return [name for flag, name in ((self.EEG, "eeg"), (self.METRICS, "pm")) if flag in self]


class App(NamedTuple):
    """A registered application and what it proves itself with."""

    client_id: str
    client_secret: str


@dataclass(frozen=True)
class User:
    """A user of Cortex: what they have done, and what they are licensed for.

    Attributes
    ----------
    approved
        They have let the registered app in.
    logged_in, other_os_user
        Whether they are logged in, and whether as another user of this machine.
    eula_accepted
        False: every authorization carries a warning.
    licence
        What the licence covers.
    session_quota
        Sessions left in the cloud on a counted licence; None = not counted.
    """

    approved: bool = True
    logged_in: bool = True
    other_os_user: bool = False
    eula_accepted: bool = True
    licence: Licence = Licence.EEG | Licence.METRICS
    session_quota: int | None = None


@dataclass(slots=True)
class _Token:
    client_id: str
    is_expired: bool = False


class Account:
    """The user's account on this machine.

    Parameters
    ----------
    apps
        Secrets of the registered apps by client id.
    approved
        Client ids of those that the user let in.
    user
        Whose account it is, as they are at first.
    seed
        Of the tokens.
    """

    def __init__(
        self, apps: Mapping[str, str], approved: set[str], user: User, *, seed: int
    ) -> None:
        self.approved = approved
        self.is_logged_in = user.logged_in
        self.licence = user.licence
        self._apps = apps
        self._user = user
        self._cloud_quota = user.session_quota
        self._local_quota = 0
        self._tokens: dict[str, _Token] = {}
        self._rng = np.random.default_rng((seed, 0xC0))

    def logins(self) -> list[dict[str, str]]:
        """Return who is logged in: nobody or one."""
        if not self.is_logged_in:
            return []
        is_other = self._user.other_os_user
        return [
            {
                "currentOSUId": "1000",
                "currentOSUsername": "participant",
                "lastLoginTime": "2026-01-05T03:00:00.000+01:00",
                "loggedInOSUId": "1001" if is_other else "1000",
                "loggedInOSUsername": "somebody" if is_other else "participant",
                "username": USER,
            }
        ]

    def identify(self, params: Mapping[str, Any]) -> str:
        """Check an app's credentials and return its client id.

        Raises
        ------
        RpcError
            If they are wrong or nobody is logged in.
        """
        client_id, secret = params["clientId"], params["clientSecret"]
        if client_id not in self._apps or self._apps[client_id] != secret:
            raise RpcError(Code.WRONG_CREDENTIALS, "The client id or secret is wrong.")
        self._need_login()
        return client_id

    def authorize(self, client_id: str, params: Mapping[str, Any]) -> dict[str, Any]:
        """Give an approved app a token and move its sessions to this machine."""
        if client_id not in self.approved:
            raise RpcError(Code.NO_ACCESS_RIGHT, "The user has not approved the application.")
        if params.get("license", LICENCE_ID) != LICENCE_ID:
            raise RpcError(Code.WRONG_LICENCE, "Invalid License Key.")
        self._draw(int(params.get("debit", 0)))
        token = ".".join(self._rng.bytes(12).hex() for _ in range(3))
        self._tokens[token] = _Token(client_id)
        reply: dict[str, Any] = {"cortexToken": token}
        if not self._user.eula_accepted:
            reply["warning"] = {"code": 6, "message": "The licence agreement is not accepted."}
        return reply

    def owner(self, params: Mapping[str, Any]) -> str:
        """Client id of the app that a request's token belongs to.

        Raises
        ------
        RpcError
            If the token is unknown or expired, or nobody is logged in.
        """
        token = self._tokens.get(params["cortexToken"])
        if token is None:
            raise RpcError(Code.INVALID_TOKEN, "The token is invalid.")
        if token.is_expired:
            raise RpcError(Code.EXPIRED_TOKEN, "The token has expired.")
        self._need_login()
        return token.client_id

    def activate(self) -> None:
        """Take one session from the licence.

        Raises
        ------
        RpcError
            If there is no licence, or no session left on this machine.
        """
        if self.licence is Licence.NONE:
            raise RpcError(Code.NO_LICENCE, "There is no valid licence for an active session.")
        if self._cloud_quota is None:
            return
        if self._local_quota == 0:
            raise RpcError(Code.SESSION_LIMIT, "Session limit on this device has been reached.")
        self._local_quota -= 1

    def expire_tokens(self) -> None:
        """Let every token given so far be expired."""
        for token in self._tokens.values():
            token.is_expired = True

    def forget_tokens(self) -> None:
        """Know no token any more."""
        self._tokens.clear()

    def licence_info(self) -> dict[str, Any]:
        """Return what ``getLicenseInfo`` answers."""
        return {
            "isOnline": True,
            "license": {
                "licenseId": LICENCE_ID,
                "scopes": self.licence.scopes,
                "expired": False,
                "localQuota": self._local_quota,
                "sessionCount": {"count": self._cloud_quota or 0, "debit": 0},
            },
        }

    def _draw(self, debit: int) -> None:
        if self._cloud_quota is not None:
            drawn = min(debit, self._cloud_quota)
            self._cloud_quota -= drawn
            self._local_quota += drawn

    def _need_login(self) -> None:
        if not self.is_logged_in:
            raise RpcError(Code.NOT_LOGGED_IN, "Nobody is logged in.")


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

    def forget_subscriptions(self, _: float = 0.0) -> None:
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


Params = Mapping[str, Any]
Result = dict[str, Any] | list[Any]
_METRIC_NAMES = {"attention": "Attention", "eng": "Engagement"}


class Methods:
    """What a client can ask for, by the method's name.

    Parameters
    ----------
    account, headset, sessions, release
        What the methods act upon.
    neighbours
        Ids of other headsets in the list that nobody can connect to.
    subscribed
        Called when a stream has a new subscriber.
    """

    def __init__(
        self,
        account: Account,
        headset: Headset,
        sessions: Sessions,
        release: Release,
        neighbours: tuple[str, ...],
        subscribed: Callable[[str], None],
    ) -> None:
        self._account = account
        self._headset = headset
        self._sessions = sessions
        self._release = release
        self._neighbours = neighbours
        self._subscribed = subscribed
        self._by_name: dict[str, Callable[[Client, Params], Result]] = {
            "getCortexInfo": self._get_cortex_info,
            "getUserLogin": self._get_user_login,
            "hasAccessRight": self._has_access_right,
            "requestAccess": self._has_access_right,
            "authorize": self._authorize,
            "getLicenseInfo": self._get_license_info,
            "controlDevice": self._control_device,
            "queryHeadsets": self._query_headsets,
            "createSession": self._create_session,
            "updateSession": self._update_session,
            "querySessions": self._query_sessions,
            "subscribe": self._subscribe,
            "unsubscribe": self._unsubscribe,
            "syncWithHeadsetClock": self._sync_with_headset_clock,
        }

    def call(self, method: str, client: Client, params: Params) -> Result:
        """Carry a request out and return its result.

        Raises
        ------
        RpcError
            If it is refused.
        """
        if method not in self._by_name:
            raise RpcError(Code.UNKNOWN_METHOD, f"There is no method {method}.")
        try:
            return self._by_name[method](client, params)
        except KeyError as missing:
            raise RpcError(Code.INVALID_PARAMS, f"The parameter {missing} is missing.") from missing

    def _get_cortex_info(self, client: Client, params: Params) -> Result:
        del client, params
        version = self._release.version
        return {
            "buildDate": "2026-01-05T03:00:00",
            "buildNumber": f"v{version}",
            "version": version,
        }

    def _get_user_login(self, client: Client, params: Params) -> Result:
        del client, params
        return self._account.logins()

    def _has_access_right(self, client: Client, params: Params) -> Result:
        del client
        granted = self._account.identify(params) in self._account.approved
        text = "Access is granted." if granted else "The user must approve it in the Launcher."
        return {"accessGranted": granted, "message": text}

    def _authorize(self, client: Client, params: Params) -> Result:
        del client
        return self._account.authorize(self._account.identify(params), params)

    def _get_license_info(self, client: Client, params: Params) -> Result:
        del client
        self._account.owner(params)
        return self._account.licence_info()

    def _control_device(self, client: Client, params: Params) -> Result:
        command = params["command"]
        if command == "refresh":
            self._headset.scan()
            return {"command": command, "message": "The list of headsets is being refreshed."}
        if command not in {"connect", "disconnect"}:
            raise RpcError(Code.INVALID_PARAMS, f"There is no command {command}.")
        if params["headset"] != self._headset.headset_id or not self._headset.status.value:
            self._headset.refuse_connect(params["headset"])
        elif command == "connect":
            self._headset.connect()
        else:
            self._headset.disconnect()
        return {"command": command, "message": f"{command} {params['headset']}"}

    def _query_headsets(self, client: Client, params: Params) -> Result:
        del client
        listed = [self._headset.describe()] if self._headset.status.value else []
        listed += [_neighbour(name) for name in self._neighbours]
        pattern = params.get("id", "*")
        return [one for one in listed if fnmatch.fnmatchcase(one["id"], pattern)]

    def _create_session(self, client: Client, params: Params) -> Result:
        client_id = self._account.owner(params)
        status = params["status"]
        if status not in {"open", "active"}:
            raise RpcError(Code.INVALID_PARAMS, f"A session cannot begin as {status}.")
        self._check_headset(params.get("headset"))
        if self._sessions.of_app(client_id):
            raise RpcError(Code.SESSION_EXISTS, "There is a session with this headset.")
        if status == "active":
            self._account.activate()
        session = self._sessions.create(client_id, client)
        session.is_active = status == "active"
        return self._describe(session)

    def _update_session(self, client: Client, params: Params) -> Result:
        del client
        session = self._own_session(params)
        match params["status"]:
            case "active":
                if not session.is_active:
                    self._account.activate()
                session.is_active = True
                return self._describe(session)
            case "close":
                self._sessions.close(session)
                return self._describe(session, "closed")
            case other:
                raise RpcError(Code.INVALID_PARAMS, f"A session cannot become {other}.")

    def _query_sessions(self, client: Client, params: Params) -> Result:
        del client
        return [self._describe(s) for s in self._sessions.of_app(self._account.owner(params))]

    def _subscribe(self, client: Client, params: Params) -> Result:
        session = self._own_session(params)
        success: list[dict[str, Any]] = []
        failure: list[dict[str, Any]] = []
        for stream in params["streams"]:
            if not self._can_have(session, stream):
                failure.append(_unavailable(stream))
                continue
            session.subscribers[stream] = client
            self._subscribed(stream)
            columns = self._release.columns(stream, self._headset.model)
            success.append({"cols": columns, "sid": session.session_id, "streamName": stream})
        return {"failure": failure, "success": success}

    def _unsubscribe(self, client: Client, params: Params) -> Result:
        del client
        session = self._own_session(params)
        success: list[dict[str, Any]] = []
        failure: list[dict[str, Any]] = []
        for stream in params["streams"]:
            if session.subscribers.pop(stream, None) is None:
                failure.append(_unavailable(stream))
            else:
                success.append({"streamName": stream})
        return {"failure": failure, "success": success}

    def _sync_with_headset_clock(self, client: Client, params: Params) -> Result:
        del client
        self._check_headset(params["headset"])
        return {
            "adjustment": round(time.time() - float(params["systemTime"]), 6),
            "headset": self._headset.headset_id,
        }

    def _can_have(self, session: Session, stream: str) -> bool:
        if stream == "eeg":
            return session.is_active and Licence.EEG in self._account.licence
        if stream == "mot" and not self._headset.model.motion_rate:
            return False
        return stream in self._release.streams

    def _check_headset(self, wanted: str | None) -> None:
        headset = self._headset
        if not headset.status.value and not self._neighbours:
            raise RpcError(Code.NO_HEADSET, "No headset is connected.")
        is_wanted = wanted in {None, headset.headset_id}
        # A headset that was switched off stays "connected" until its silence is noticed.
        if not is_wanted or headset.status is not Status.CONNECTED or not headset.is_on:
            raise RpcError(Code.HEADSET_UNAVAILABLE, "The headset is not available.")

    def _own_session(self, params: Params) -> Session:
        session = self._sessions.find(self._account.owner(params), params["session"])
        if session is None:
            raise RpcError(Code.NO_SESSION, "There is no such session.")
        return session

    def _describe(self, session: Session, status: str = "") -> dict[str, Any]:
        described = session.describe(self._headset.describe(), status)
        if self._release.names_metrics:
            described["performanceMetrics"] = [
                {
                    "apiName": short,
                    "displayedName": name,
                    "name": name.lower(),
                    "shortDisplayedName": name[:2],
                }
                for short, name in _METRIC_NAMES.items()
            ]
        return described


def _unavailable(stream: str) -> dict[str, Any]:
    message = "The stream is unavailable or unsupported."
    return {"code": int(Code.NO_STREAM), "message": message, "streamName": stream}


def _neighbour(headset_id: str) -> dict[str, Any]:
    return {
        "connectedBy": "bluetooth",
        "firmware": "",
        "id": headset_id,
        "isVirtual": False,
        "motionSensors": [],
        "sensors": [],
        "settings": {"eegRate": 0, "eegRes": 0, "memsRate": 0, "memsRes": 0, "mode": "UNKNOWN"},
        "status": Status.DISCOVERED.value,
    }
