"""Parses Cortex messages: replies, warnings and data, as JSON-RPC 2.0 text.

::

    reply    {"id":n, "result":...} or {"id":n, "error":{"code":c, "message":s}}
    warning  {"warning":{"code":c, "message": s or {"behavior":s, "headsetId":s, ...}}}
    data     {"<stream>":[...], "sid":s, "time":unix seconds}

Source: Cortex API documentation. `parse` accepts any text and never raises.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, unique
from typing import NamedTuple, NoReturn, cast

from pydantic_core import from_json


@unique
class ErrorKind(Enum):
    """How to handle an error."""

    TOKEN = "token"  # noqa: S105 - a kind, no token
    """Authorize again once, and repeat the call."""
    LICENSE = "license"
    """Continue without what the licence does not cover."""
    STREAM = "stream"
    """The stream is not available."""
    SESSION = "session"
    """Create a new session."""
    HEADSET = "headset"
    """The headset is not available."""
    RETRY_HEADSET = "retry_headset"
    """The headset is almost ready: repeat the call after a moment."""
    USER = "user"
    """Nobody is logged in."""
    ACCESS = "access"
    """The user has not approved the application."""
    PROFILE = "profile"
    CREDENTIALS = "credentials"
    """The client id or secret is wrong: the user must correct it."""
    RETRY = "retry"
    """Cortex or its cloud service is not ready."""
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
    """Meaning of a warning."""

    SUBSCRIPTIONS_STOPPED = "subscriptions_stopped"
    SESSION_CLOSED = "session_closed"
    USER_LOGIN = "user_login"
    USER_LOGOUT = "user_logout"
    EULA_MISSING = "eula_missing"
    EULA_ACCEPTED = "eula_accepted"
    ACCESS_GRANTED = "access_granted"
    ACCESS_REJECTED = "access_rejected"
    CLIENT_UNKNOWN = "client_unknown"
    """Cortex cannot identify the client program: a new connection helps."""
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
    """Return how to handle an error."""
    return _KIND_BY_CODE.get(code, ErrorKind.OTHER)


def event(code: int) -> Event:
    """Return the meaning of a warning."""
    return _EVENTS.get(code, Event.UNKNOWN)


STREAMS = frozenset({"eeg", "mot", "dev", "eq", "pow", "met", "com", "fac", "sys"})
MAX_TIME_S = 1e11
"""Upper limit of valid clock times."""


@unique
class FaultCode(Enum):
    """Why a message or sample is unusable."""

    BAD_JSON = "bad_json"
    NOT_AN_OBJECT = "not_an_object"
    NON_FINITE = "non_finite"
    UNKNOWN_MESSAGE = "unknown_message"
    UNKNOWN_ID = "unknown_id"
    """A reply without a waiting request: late or repeated."""
    UNKNOWN_SESSION = "unknown_session"
    UNKNOWN_STREAM = "unknown_stream"
    NO_TIME = "no_time"
    LENGTH_MISMATCH = "length_mismatch"
    BAD_TYPE = "bad_type"


@dataclass(frozen=True, slots=True)
class Fault:
    """An unusable message."""

    code: FaultCode


@dataclass(frozen=True, slots=True)
class RpcError:
    """Why a request failed."""

    code: int
    text: str

    @property
    def kind(self) -> ErrorKind:
        """How to handle it."""
        return error_kind(self.code)


@dataclass(frozen=True, slots=True)
class Warned:
    """A warning that Cortex sends by itself."""

    code: int
    text: str = ""  # Cortex's own text, which is only displayed.
    # headset, session: the headset and session concerned; empty if not given.
    headset: str = ""
    session: str = ""

    @property
    def event(self) -> Event:
        """Its meaning."""
        return event(self.code)


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer to a request."""

    request_id: int
    result: object = None  # JSON value; None if there is an error.
    error: RpcError | None = None
    attention: Warned | None = None  # A problem with the headset search, sent with its answer.


class Data(NamedTuple):
    """One sample, with its values in the order of the stream's columns."""

    stream: str
    session: str
    time_s: float  # Unix time of the sample on the clock of the computer that runs Cortex.
    values: list[object]  # JSON values.


Message = Reply | Warned | Data | Fault


class _NonFiniteError(ValueError):
    """JSON has no NaN, but Python's parser accepts it."""


def parse(text: str) -> Message:
    """Parse one message; an unreadable one becomes a Fault."""
    try:
        message: object = from_json(text, allow_inf_nan=False)
    except ValueError:
        # Rare fallback: Python's parser gives a reason and accepts unpaired surrogates.
        try:
            message = _DECODER.decode(text)
        except _NonFiniteError:
            return Fault(FaultCode.NON_FINITE)
        except (ValueError, RecursionError):
            return Fault(FaultCode.BAD_JSON)
    if not isinstance(message, dict):
        return Fault(FaultCode.NOT_AN_OBJECT)
    return _dispatch(cast("dict[str, object]", message))


def text_of(value: object) -> str:
    """Return a JSON text, empty for any other JSON value."""
    # JSON can contain unpaired surrogates, which logs and streams cannot.
    return value.encode(errors="replace").decode() if isinstance(value, str) else ""


def object_of(value: object) -> Mapping[str, object]:
    """Return a JSON object, empty for any other JSON value."""
    return cast("dict[str, object]", value) if isinstance(value, dict) else {}


def list_of(value: object) -> list[object]:
    """Return a JSON list, empty for any other JSON value."""
    return cast("list[object]", value) if isinstance(value, list) else []


def number_of(value: object) -> float | None:
    """Return a finite JSON number, None for any other JSON value."""
    if type(value) is float and -math.inf < value < math.inf:
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _reject(constant: str) -> NoReturn:
    raise _NonFiniteError(constant)


_DECODER = json.JSONDecoder(parse_constant=_reject)


def _dispatch(fields: Mapping[str, object]) -> Message:
    if "sid" in fields:
        return _data(fields)
    if "warning" in fields:
        return _warned(fields["warning"])
    if "id" in fields:
        return _reply(fields)
    return Fault(FaultCode.UNKNOWN_MESSAGE)


def _data(fields: Mapping[str, object]) -> Data | Fault:
    for stream in fields:
        if stream in STREAMS:
            break
    else:
        return Fault(FaultCode.UNKNOWN_STREAM)
    session = fields["sid"]
    if not isinstance(session, str):
        return Fault(FaultCode.UNKNOWN_SESSION)
    time_s = number_of(fields.get("time"))
    if time_s is None or not 0 < time_s < MAX_TIME_S:
        return Fault(FaultCode.NO_TIME)
    values = fields[stream]
    if not isinstance(values, list):
        return Fault(FaultCode.BAD_TYPE)
    return Data(stream, session, time_s, cast("list[object]", values))


def _warned(value: object) -> Warned | Fault:
    warning = object_of(value)
    code = warning.get("code")
    if not _is_integer(code):
        return Fault(FaultCode.UNKNOWN_MESSAGE)
    message = warning.get("message")
    details = object_of(message)
    return Warned(
        code=cast("int", code),
        text=text_of(message) or text_of(details.get("behavior")),
        headset=text_of(details.get("headsetId")) or text_of(details.get("headset")),
        session=text_of(details.get("sessionId")),
    )


def _reply(fields: Mapping[str, object]) -> Reply | Fault:
    request_id = fields["id"]
    if not _is_integer(request_id):
        return Fault(FaultCode.UNKNOWN_ID)
    number = cast("int", request_id)
    error = fields.get("error")
    if error is not None:
        return Reply(number, error=_error(object_of(error)))
    attention = _warned(fields["attention"]) if "attention" in fields else None
    return Reply(
        number,
        fields.get("result"),
        attention=attention if isinstance(attention, Warned) else None,
    )


def _error(error: Mapping[str, object]) -> RpcError:
    code = error.get("code")
    text = text_of(error.get("message")) or "no reason"
    return RpcError(cast("int", code) if _is_integer(code) else 0, text)


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
