"""Numbers of Cortex' errors and warnings, and what they mean for a client.

Source: error and warning tables of the Cortex API documentation and of the
vendor's examples; the texts that come with them vary and decide nothing.
"""

from __future__ import annotations

from enum import Enum, unique


@unique
class ErrorKind(Enum):
    """What to do about an error."""

    TOKEN = "token"  # noqa: S105 - a kind, no token
    """Authorize again, once, and repeat the call."""
    LICENSE = "license"
    """Go on without what the licence does not cover."""
    STREAM = "stream"
    """This stream is not to be had."""
    SESSION = "session"
    """Make a new session."""
    HEADSET = "headset"
    """The headset is not there."""
    RETRY_HEADSET = "retry_headset"
    """The headset is nearly there: repeat the call in a moment."""
    USER = "user"
    """Nobody is logged in."""
    ACCESS = "access"
    """The user has not approved the application."""
    PROFILE = "profile"
    CREDENTIALS = "credentials"
    """The client id or secret is wrong: only a person can help."""
    RETRY = "retry"
    """Cortex or its cloud is not ready."""
    BUG = "bug"
    """The request itself is wrong."""
    OTHER = "other"


_ERRORS = {
    ErrorKind.TOKEN: (-32014, -32015, -32034),
    ErrorKind.LICENSE: (-32002, -32006, -32019, -32022, -32024, -32027, -32230, -32232),
    ErrorKind.STREAM: (-32016,),
    ErrorKind.SESSION: (-32005, -32007, -32012),
    ErrorKind.HEADSET: (-32001, -32004),
    ErrorKind.RETRY_HEADSET: (-32152,),
    ErrorKind.USER: (-32033,),
    ErrorKind.ACCESS: (-32102,),
    ErrorKind.PROFILE: (-32046,),
    ErrorKind.CREDENTIALS: (-32021, -32142),
    ErrorKind.RETRY: (-32000, -32003, -32122, -32130, -32603),
    ErrorKind.BUG: (-32700, -32600, -32601, -32602),
}
_KIND_BY_CODE = {code: kind for kind, codes in _ERRORS.items() for code in codes}

SESSION_EXISTS = -32005
SESSION_NOT_ACTIVE = -32012


@unique
class Event(Enum):
    """What a warning tells."""

    SUBSCRIPTIONS_STOPPED = "subscriptions_stopped"
    SESSION_CLOSED = "session_closed"
    USER_LOGIN = "user_login"
    USER_LOGOUT = "user_logout"
    EULA_MISSING = "eula_missing"
    EULA_ACCEPTED = "eula_accepted"
    ACCESS_GRANTED = "access_granted"
    ACCESS_REJECTED = "access_rejected"
    CLIENT_UNKNOWN = "client_unknown"
    """Cortex cannot tell which program the client is: a new connection helps."""
    OTHER_OS_USER = "other_os_user"
    DISK_LOW = "disk_low"
    CORTEX_READY = "cortex_ready"
    LICENSE_EXPIRES = "license_expires"
    BLUETOOTH_DENIED = "bluetooth_denied"
    HEADSET_CONNECT_FAILED = "headset_connect_failed"
    HEADSET_LOST = "headset_lost"
    HEADSET_CONNECTED = "headset_connected"
    SCAN_FINISHED = "scan_finished"
    UNKNOWN = "unknown"


_EVENTS = {
    0: Event.SUBSCRIPTIONS_STOPPED,
    1: Event.SESSION_CLOSED,
    2: Event.USER_LOGIN,
    3: Event.USER_LOGOUT,
    6: Event.EULA_MISSING,
    28: Event.EULA_MISSING,
    17: Event.EULA_ACCEPTED,
    9: Event.ACCESS_GRANTED,
    10: Event.ACCESS_REJECTED,
    11: Event.CLIENT_UNKNOWN,
    12: Event.CLIENT_UNKNOWN,
    16: Event.OTHER_OS_USER,
    19: Event.DISK_LOW,
    20: Event.DISK_LOW,
    23: Event.CORTEX_READY,
    26: Event.LICENSE_EXPIRES,
    31: Event.BLUETOOTH_DENIED,
    100: Event.HEADSET_CONNECT_FAILED,
    101: Event.HEADSET_CONNECT_FAILED,
    102: Event.HEADSET_CONNECT_FAILED,
    103: Event.HEADSET_LOST,
    104: Event.HEADSET_CONNECTED,
    142: Event.SCAN_FINISHED,
}


def error_kind(code: int) -> ErrorKind:
    """Tell what to do about an error."""
    return _KIND_BY_CODE.get(code, ErrorKind.OTHER)


def event(code: int) -> Event:
    """Tell what a warning means."""
    return _EVENTS.get(code, Event.UNKNOWN)
