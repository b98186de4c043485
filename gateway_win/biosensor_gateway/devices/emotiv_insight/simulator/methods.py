"""The methods of the API."""

from __future__ import annotations

import fnmatch
import time
from collections.abc import Callable, Mapping
from typing import Any

from biosensor_gateway.devices.emotiv_insight.simulator.account import Account, Licence
from biosensor_gateway.devices.emotiv_insight.simulator.errors import Code, RpcError
from biosensor_gateway.devices.emotiv_insight.simulator.headset import Headset, Status
from biosensor_gateway.devices.emotiv_insight.simulator.listener import Client
from biosensor_gateway.devices.emotiv_insight.simulator.release import Release
from biosensor_gateway.devices.emotiv_insight.simulator.sessions import Session, Sessions

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
