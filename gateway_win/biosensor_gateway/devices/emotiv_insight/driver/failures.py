"""Turns Cortex' refusals into errors by which the agent decides when to try again."""

from __future__ import annotations

from biosensor_common.errors import (
    CredentialError,
    CredentialReason,
    GatewayError,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.emotiv_insight.driver.codes import ErrorKind, Event
from biosensor_gateway.devices.emotiv_insight.driver.cortex import CortexError
from biosensor_gateway.devices.emotiv_insight.driver.messages import Warned

_ABSENT = TransportReason.ABSENT
_LOST = TransportReason.LOST
_MISSING = CredentialReason.MISSING
_REJECTED = CredentialReason.REJECTED

_ERRORS: dict[ErrorKind, tuple[TransportReason | CredentialReason, str]] = {
    ErrorKind.CREDENTIALS: (_REJECTED, "check the client id and secret of the Cortex app"),
    ErrorKind.TOKEN: (_REJECTED, "log out of EMOTIV Launcher and in again"),
    ErrorKind.USER: (_MISSING, "log in to EMOTIV Launcher"),
    ErrorKind.ACCESS: (_MISSING, "approve this application in EMOTIV Launcher"),
    ErrorKind.LICENSE: (
        _REJECTED,
        "check the licence; a Cortex app that requires EEG needs a licence with EEG",
    ),
    ErrorKind.HEADSET: (_ABSENT, "switch the headset on, near this computer"),
    ErrorKind.RETRY_HEADSET: (_ABSENT, "wait until EMOTIV Launcher shows it as ready"),
    ErrorKind.SESSION: (_LOST, "the session is made anew"),
}

ENDINGS = {
    Event.SUBSCRIPTIONS_STOPPED: (_LOST, "Cortex has stopped the streams"),
    Event.SESSION_CLOSED: (_LOST, "Cortex has closed the session"),
    Event.HEADSET_LOST: (_LOST, "Cortex has lost the headset; is it on, charged and near?"),
    Event.CLIENT_UNKNOWN: (_LOST, "Cortex asks for a new connection"),
    Event.USER_LOGOUT: (_MISSING, "the user has logged out of EMOTIV Launcher; log in there"),
    Event.OTHER_OS_USER: (
        TransportReason.BUSY,
        "another user of this computer has logged in to EMOTIV Launcher",
    ),
}
"""Warnings that end a connection."""


def gateway_error(error: CortexError) -> GatewayError:
    """Return the error of the class that tells what to do; its own where that is "try later"."""
    found = _ERRORS.get(error.kind)
    return error if found is None else _error(found[0], f"{error}; {found[1]}")


def ending(warned: Warned, headset_id: str, session_id: str) -> GatewayError | None:
    """Return the error that a warning makes of a connection; None if it concerns another one."""
    if warned.session not in ("", session_id) or warned.headset not in ("", headset_id):
        return None
    found = ENDINGS.get(warned.event)
    return None if found is None else _error(*found)


def _error(reason: TransportReason | CredentialReason, message: str) -> GatewayError:
    if isinstance(reason, TransportReason):
        return TransportError(reason, message)
    return CredentialError(reason, message)
