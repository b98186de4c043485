"""Requests and replies of a virtual Cortex, with their faults."""

from __future__ import annotations

import asyncio
import fnmatch
import json
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from biosensor_gateway.devices.emotiv_insight.simulator.account import (
    Account,
    Code,
    Licence,
    RpcError,
    Session,
    Sessions,
)
from biosensor_gateway.devices.emotiv_insight.simulator.headset import Headset, Release, Status
from biosensor_gateway.devices.emotiv_insight.simulator.listener import Client

Params = Mapping[str, Any]
Result = dict[str, Any] | list[Any]
_METRIC_NAMES = {"attention": "Attention", "eng": "Engagement"}


class Methods:
    """The API methods that a client can call.

    Parameters
    ----------
    account, headset, sessions, release
        Objects that the methods use.
    neighbours
        Ids of other headsets in the list that cannot be connected.
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
        self.denied: frozenset[str] = frozenset()
        self._account = account
        self._headset = headset
        self._sessions = sessions
        self._release = release
        self._neighbours = neighbours
        self._subscribed = subscribed
        version = release.version
        about = {
            "buildDate": "2026-01-05T03:00:00",
            "buildNumber": f"v{version}",
            "version": version,
        }
        self._by_name: dict[str, Callable[[Client, Params], Result]] = {
            "getCortexInfo": lambda _, __: about,
            "getUserLogin": lambda _, __: account.logins(),
            "hasAccessRight": self._has_access_right,
            "authorize": lambda _, params: account.authorize(account.identify(params), params),
            "getLicenseInfo": self._get_license_info,
            "controlDevice": self._control_device,
            "queryHeadsets": self._query_headsets,
            "createSession": self._create_session,
            "updateSession": self._update_session,
            "querySessions": self._query_sessions,
            "subscribe": self._subscribe,
            "unsubscribe": self._unsubscribe,
        }

    def call(self, method: str, client: Client, params: Params) -> Result:
        """Execute a request and return its result.

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

    def _has_access_right(self, _: Client, params: Params) -> Result:
        self._account.identify(params)
        return {"accessGranted": True, "message": "Access is granted."}

    def _get_license_info(self, _: Client, params: Params) -> Result:
        self._account.owner(params)
        return self._account.licence_info()

    def _control_device(self, _: Client, params: Params) -> Result:
        command = params["command"]
        if command == "refresh":
            self._headset.scan()
            return {"command": command, "message": "The list of headsets is being refreshed."}
        if command != "connect":
            raise RpcError(Code.INVALID_PARAMS, f"There is no command {command}.")
        if params["headset"] != self._headset.headset_id or not self._headset.status.value:
            self._headset.refuse_connect(params["headset"])
        else:
            self._headset.connect()
        return {"command": command, "message": f"{command} {params['headset']}"}

    def _query_headsets(self, _: Client, params: Params) -> Result:
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
            raise RpcError(Code.SESSION_EXISTS)
        if status == "active":
            self._account.activate()
        session = self._sessions.create(client_id, client)
        session.is_active = status == "active"
        return self._describe(session)

    def _update_session(self, _: Client, params: Params) -> Result:
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

    def _query_sessions(self, _: Client, params: Params) -> Result:
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

    def _unsubscribe(self, _: Client, params: Params) -> Result:
        session = self._own_session(params)
        success: list[dict[str, Any]] = []
        failure: list[dict[str, Any]] = []
        for stream in params["streams"]:
            if session.subscribers.pop(stream, None) is None:
                failure.append(_unavailable(stream))
            else:
                success.append({"streamName": stream})
        return {"failure": failure, "success": success}

    def _can_have(self, session: Session, stream: str) -> bool:
        if stream in self.denied:
            return False
        if stream == "eeg":
            return session.is_active and Licence.EEG in self._account.licence
        if stream == "mot" and not self._headset.model.motion_rate:
            return False
        return stream in self._release.streams

    def _check_headset(self, wanted: str | None) -> None:
        headset = self._headset
        if not headset.status.value and not self._neighbours:
            raise RpcError(Code.NO_HEADSET)
        is_wanted = wanted in {None, headset.headset_id}
        if not is_wanted or headset.status is not Status.CONNECTED:
            raise RpcError(Code.HEADSET_UNAVAILABLE)

    def _own_session(self, params: Params) -> Session:
        session = self._sessions.find(self._account.owner(params), params["session"])
        if session is None:
            raise RpcError(Code.NO_SESSION)
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
    return {**RpcError(Code.NO_STREAM).described(), "streamName": stream}


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


_STRANGER = "00000000-0000-0000-0000-000000000000"


def damaged_message(rng: np.random.Generator, session_id: str) -> str | bytes:
    """Return one damaged message.

    Parameters
    ----------
    rng
        Chooses the kind of damage.
    session_id
        A valid session of the receiving client, so that only the damage is wrong.
    """
    eeg: list[object] = [1, 0, 1, 1, 1, 1, 1, 0, 0, []]
    sample: dict[str, object] = {"eeg": eeg, "sid": session_id, "time": 1.0}
    intact = json.dumps(sample)
    return (
        intact[: len(intact) // 2],
        intact.replace("[1, 0, 1,", "[1, 0, NaN,"),
        json.dumps(sample | {"eeg": eeg[:4]}),
        json.dumps(sample | {"eeg": [1, 0, "x", *eeg[3:]]}),
        json.dumps({"eeg": eeg, "sid": session_id}),
        json.dumps(sample | {"sid": _STRANGER}),
        json.dumps({"xyz": [1], "sid": session_id, "time": 1.0}),
        json.dumps({"dev": 7, "sid": session_id, "time": 1.0}),
        json.dumps({"jsonrpc": "2.0"}),
        json.dumps({"jsonrpc": "2.0", "id": 424242, "result": {}}),
        json.dumps({"jsonrpc": "2.0", "id": 424242, "error": {"code": -32603}}),
        json.dumps({"jsonrpc": "2.0", "warning": "none"}),
        "[1,2,3]",
        "",
        rng.bytes(64),
    )[rng.integers(15)]


_KEPT_CALLS = 10_000
_REFUSED_METHODS = frozenset({"authorize", "createSession", "subscribe"})


@dataclass(slots=True)
class Manners:
    """Behaviour of the server's answers."""

    late_s: float = 0.0  # Delay of all answers.
    refusal: int | None = None  # Error code for requests that lead to data; None if not refused.
    is_starting: bool = False  # Whether only the version is available yet.

    def check(self, method: str) -> None:
        """Raise the error of a request that must be refused, before it has any effect.

        Raises
        ------
        RpcError
        """
        if self.is_starting and method != "getCortexInfo":
            raise RpcError(Code.STARTING)
        if self.refusal is not None and method in _REFUSED_METHODS:
            raise RpcError(self.refusal)


class Replies:
    """Parses, executes and answers requests."""

    def __init__(self, methods: Methods, manners: Manners, loop: asyncio.AbstractEventLoop) -> None:
        self.calls: deque[str] = deque(maxlen=_KEPT_CALLS)  # Names of the methods called, in order.
        self._methods = methods
        self._manners = manners
        self._loop = loop

    def hear(self, client: Client, message: str | bytes) -> None:
        """Process one message of a client."""
        try:
            request = json.loads(message)
        except ValueError:
            self._answer(client, _failure(None, RpcError(Code.PARSE)))
            return
        fields = cast("dict[str, Any]", request) if isinstance(request, dict) else {}
        self._answer(client, self._carry_out(client, fields))

    def _carry_out(self, client: Client, fields: dict[str, Any]) -> dict[str, Any]:
        method, params = fields.get("method"), fields.get("params", {})
        if not isinstance(method, str) or not isinstance(params, dict):
            return _failure(fields.get("id"), RpcError(Code.INVALID_REQUEST))
        self.calls.append(method)
        reply: dict[str, Any] = {"id": fields.get("id"), "jsonrpc": "2.0"}
        try:
            self._manners.check(method)
            reply["result"] = self._methods.call(method, client, cast("dict[str, Any]", params))
        except RpcError as error:
            return _failure(fields.get("id"), error)
        return reply

    def _answer(self, client: Client, reply: dict[str, Any]) -> None:
        text = json.dumps(reply)
        if self._manners.late_s:
            self._loop.call_later(self._manners.late_s, client.send, text)
        else:
            client.send(text)


def _failure(request_id: object, error: RpcError) -> dict[str, Any]:
    return {"error": error.described(), "id": request_id, "jsonrpc": "2.0"}
