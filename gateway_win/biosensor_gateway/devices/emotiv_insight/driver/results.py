"""Reads the results of Cortex' methods without trust in their form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.emotiv_insight.driver.messages import (
    list_of,
    number_of,
    object_of,
    text_of,
)
from biosensor_gateway.devices.emotiv_insight.driver.protocol import Layout, layout


@dataclass(frozen=True, slots=True)
class Login:
    """Who uses the vendor's launcher.

    Attributes
    ----------
    same_os_user
        False if it is somebody else who is logged in to this computer.
    """

    logged_in: bool
    same_os_user: bool = True


@dataclass(frozen=True, slots=True)
class Licence:
    """What the user's licence covers.

    Attributes
    ----------
    scopes
        ``eeg`` for raw EEG, ``pm`` for performance metrics at their full rate.
    """

    scopes: frozenset[str] = frozenset()
    expired: bool = False


@dataclass(frozen=True, slots=True)
class Headset:
    """A headset that Cortex knows.

    Attributes
    ----------
    status
        ``discovered``, ``connecting`` or ``connected``.
    eeg_rate_hz, motion_rate_hz
        0 while it is not connected, or the motion sensor is off.
    electrodes
        Of the headset's own list; empty while it is not connected.
    """

    headset_id: str
    status: str = ""
    name: str = ""
    firmware: str = ""
    eeg_rate_hz: float = 0.0
    motion_rate_hz: float = 0.0
    is_virtual: bool = False
    electrodes: tuple[str, ...] = ()

    @property
    def is_connected(self) -> bool:
        """Whether it can have a session."""
        return self.status == "connected"


@dataclass(frozen=True, slots=True)
class SessionState:
    """A session of this application."""

    session_id: str
    status: str
    headset_id: str = ""

    @property
    def is_active(self) -> bool:
        """Whether it may have the licensed streams."""
        return self.status == "activated"

    @property
    def is_closed(self) -> bool:
        """Whether it is of no use any more."""
        return self.status == "closed"


@dataclass(frozen=True, slots=True)
class Subscription:
    """Outcome of ``subscribe``.

    Attributes
    ----------
    layouts
        Columns by stream.
    failures
        Error code by stream.
    session_id
        What the streams' data will name as their session; empty if it does not say.
    """

    layouts: Mapping[str, Layout] = field(default_factory=dict[str, Layout])
    failures: Mapping[str, int] = field(default_factory=dict[str, int])
    session_id: str = ""


def version(result: object) -> str:
    """Read ``getCortexInfo``."""
    return text_of(object_of(result).get("version"))


def login(result: object) -> Login:
    """Read ``getUserLogin``."""
    users = [object_of(user) for user in list_of(result)]
    if not users:
        return Login(logged_in=False)
    user = users[0]
    current, logged_in = user.get("currentOSUId"), user.get("loggedInOSUId")
    return Login(logged_in=True, same_os_user=not (current and logged_in) or current == logged_in)


def access_granted(result: object) -> bool:
    """Read ``hasAccessRight`` or ``requestAccess``."""
    return object_of(result).get("accessGranted") is True


def token(result: object) -> str:
    """Read ``authorize``.

    Raises
    ------
    ProtocolError
        ``GARBAGE``.
    """
    return _required(object_of(result).get("cortexToken"), "a token")


def licence(result: object) -> Licence:
    """Read ``getLicenseInfo``; what it does not say is not covered."""
    fields = object_of(object_of(result).get("license"))
    scopes = frozenset(text_of(each) for each in list_of(fields.get("scopes")))
    return Licence(scopes, expired=fields.get("expired") is True)


def eula_missing(result: object) -> bool:
    """Whether ``authorize`` tells that the user has not accepted the licence agreement."""
    return bool(object_of(result).get("warning"))


def headsets(result: object) -> list[Headset]:
    """Read ``queryHeadsets``; what has no id is left out."""
    read = [_headset(object_of(each)) for each in list_of(result)]
    return [headset for headset in read if headset.headset_id]


def session(result: object) -> SessionState:
    """Read ``createSession`` or ``updateSession``.

    Raises
    ------
    ProtocolError
        ``GARBAGE``.
    """
    fields = object_of(result)
    return SessionState(
        _required(fields.get("id"), "a session"),
        text_of(fields.get("status")),
        text_of(object_of(fields.get("headset")).get("id")),
    )


def sessions(result: object) -> list[SessionState]:
    """Read ``querySessions``; what has no id is left out."""
    return [session(each) for each in list_of(result) if text_of(object_of(each).get("id"))]


def subscription(result: object) -> Subscription:
    """Read ``subscribe``; a stream without usable columns has failed with code 0."""
    fields = object_of(result)
    layouts: dict[str, Layout] = {}
    failures: dict[str, int] = {}
    session_id = ""
    for each in map(object_of, list_of(fields.get("success"))):
        stream, columns = text_of(each.get("streamName")), layout(each.get("cols"))
        if columns is None:
            failures[stream] = 0
        else:
            layouts[stream] = columns
            session_id = text_of(each.get("sid"))
    for each in map(object_of, list_of(fields.get("failure"))):
        failures[text_of(each.get("streamName"))] = int(number_of(each.get("code")) or 0)
    return Subscription(layouts, failures, session_id)


def _headset(fields: Mapping[str, object]) -> Headset:
    settings = object_of(fields.get("settings"))
    return Headset(
        headset_id=text_of(fields.get("id")),
        status=text_of(fields.get("status")),
        name=text_of(fields.get("customName")),
        firmware=text_of(fields.get("firmware")),
        eeg_rate_hz=number_of(settings.get("eegRate")) or 0.0,
        motion_rate_hz=number_of(settings.get("memsRate")) or 0.0,
        is_virtual=fields.get("isVirtual") is True,
        electrodes=tuple(text_of(each) for each in list_of(fields.get("sensors"))),
    )


def _required(value: object, what: str) -> str:
    if not isinstance(value, str) or not value:
        message = (
            f"Cortex answers without {what}; is this version of EMOTIV Launcher known to work?"
        )
        raise ProtocolError(ProtocolReason.GARBAGE, message)
    return value
