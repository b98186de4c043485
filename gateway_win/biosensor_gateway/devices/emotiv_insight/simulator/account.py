"""Keeps the user, the apps, their tokens and the licence, and says who may do what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Flag, auto
from typing import Any, NamedTuple

import numpy as np

from biosensor_gateway.devices.emotiv_insight.simulator.errors import Code, RpcError

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
