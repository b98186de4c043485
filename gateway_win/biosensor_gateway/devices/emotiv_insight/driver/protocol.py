"""Parses results of Cortex methods, and assigns labels to data by the subscribed columns.

The order and number of columns depend on headset, firmware and Cortex version, and are only known
from the reply to ``subscribe``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple, cast

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.emotiv_insight.driver.messages import (
    Data,
    Fault,
    FaultCode,
    list_of,
    number_of,
    object_of,
    text_of,
)

Column = str | tuple[str, ...]
"""A label, or several for a nested list, such as the contact qualities of ``dev``."""

_NUMERIC_STREAMS = frozenset({"eeg", "mot", "dev", "eq", "pow", "met"})
_NOT_NUMBERS = (".isActive", "MARKERS")
# Integers below this limit are exact as floats.
_MOST = 1 << 53


@dataclass(frozen=True, slots=True)
class Layout:
    """Columns of one stream of one session."""

    columns: tuple[Column, ...]

    @property
    def labels(self) -> frozenset[str]:
        """All labels, including those of nested columns."""
        return frozenset(self.in_order())

    def in_order(self) -> tuple[str, ...]:
        """Return all labels in the order of the values, with nested columns flattened."""
        return tuple(
            label
            for column in self.columns
            for label in ((column,) if isinstance(column, str) else column)
        )


class Sample(NamedTuple):
    """One sample of one stream."""

    stream: str
    time_s: float  # Unix time on the clock of the computer that runs Cortex.
    numbers: Mapping[str, float]  # Numbers by label; NaN if Cortex has no value.
    others: Mapping[str, object] = MappingProxyType({})  # Texts, booleans and lists by label.


class _Reading(NamedTuple):
    """Precomputed information for decoding the samples of one stream quickly."""

    columns: tuple[Column, ...]
    is_nested: bool
    labels: tuple[tuple[str, bool], ...]
    """Labels, each with whether its value must be a number."""


class _FaultError(Exception):
    def __init__(self, code: FaultCode) -> None:
        super().__init__(code.value)
        self.code = code


def layout(cols: object) -> Layout | None:
    """Parse the ``cols`` of a subscription; None if they are not a list of labels."""
    columns: list[Column] = []
    for column in list_of(cols):
        if isinstance(column, str):
            columns.append(column)
            continue
        labels = list_of(column)
        if not labels or not all(isinstance(label, str) for label in labels):
            return None
        columns.append(tuple(cast("list[str]", labels)))
    return Layout(tuple(columns)) if columns else None


class Decoder:
    """Decodes the data of subscribed sessions and streams."""

    def __init__(self) -> None:
        self._readings: dict[str, dict[str, _Reading]] = {}

    def subscribed(self, session: str, layouts: Mapping[str, Layout]) -> None:
        """Add the layouts of a session's streams."""
        readings = self._readings.setdefault(session, {})
        for stream, columns in layouts.items():
            readings[stream] = _reading(stream, columns)

    def decode(self, data: Data) -> Sample | Fault:
        """Assign labels to the values of a message; never raises."""
        readings = self._readings.get(data.session)
        if readings is None:
            return Fault(FaultCode.UNKNOWN_SESSION)
        reading = readings.get(data.stream)
        if reading is None:
            return Fault(FaultCode.UNKNOWN_STREAM)
        try:
            numbers, others = _labelled(reading, data.values)
        except _FaultError as fault:
            return Fault(fault.code)
        return Sample(data.stream, data.time_s, numbers, others)


def _reading(stream: str, columns: Layout) -> _Reading:
    is_numeric = stream in _NUMERIC_STREAMS
    return _Reading(
        columns=columns.columns,
        is_nested=not all(isinstance(column, str) for column in columns.columns),
        labels=tuple(
            (label, is_numeric and not label.endswith(_NOT_NUMBERS)) for label in columns.in_order()
        ),
    )


def _labelled(
    reading: _Reading, values: list[object]
) -> tuple[dict[str, float], dict[str, object]]:
    if len(reading.columns) != len(values):
        raise _FaultError(FaultCode.LENGTH_MISMATCH)
    if reading.is_nested:
        values = list(_flat(reading.columns, values))
    numbers: dict[str, float] = {}
    others: dict[str, object] = {}
    for (label, is_number), value in zip(reading.labels, values, strict=True):
        # Inlined for speed, because most values are finite floats.
        if type(value) is float and -math.inf < value < math.inf:
            numbers[label] = value
        elif type(value) is int and -_MOST < value < _MOST:
            numbers[label] = float(value)
        elif (number := number_of(value)) is not None:
            numbers[label] = number
        elif is_number:
            numbers[label] = _missing(value)
        else:
            others[label] = value
    return numbers, others


def _flat(columns: tuple[Column, ...], values: list[object]) -> Iterable[object]:
    for column, value in zip(columns, values, strict=True):
        if isinstance(column, str):
            yield value
        else:
            yield from _nested(column, value)


def _nested(labels: tuple[str, ...], value: object) -> Iterable[object]:
    if value is None:
        return (None for _ in labels)
    if not isinstance(value, list):
        raise _FaultError(FaultCode.BAD_TYPE)
    values = cast("list[object]", value)
    if len(values) != len(labels):
        raise _FaultError(FaultCode.LENGTH_MISMATCH)
    return values


def _missing(value: object) -> float:
    """Return NaN for a missing value; anything else is invalid."""
    if value is None:
        return math.nan
    not_finite = isinstance(value, int | float) and not isinstance(value, bool)
    raise _FaultError(FaultCode.NON_FINITE if not_finite else FaultCode.BAD_TYPE)


@dataclass(frozen=True, slots=True)
class Login:
    """The user logged in to the vendor's launcher."""

    logged_in: bool
    same_os_user: bool = True  # Whether it is the current user of this computer.


@dataclass(frozen=True, slots=True)
class Licence:
    """Coverage of the user's licence."""

    # `eeg` for raw EEG, `pm` for performance metrics at their full rate.
    scopes: frozenset[str] = frozenset()
    expired: bool = False


@dataclass(frozen=True, slots=True)
class Headset:
    """A headset that Cortex knows."""

    headset_id: str
    status: str = ""  # `discovered`, `connecting` or `connected`.
    name: str = ""
    firmware: str = ""
    # eeg_rate_hz, motion_rate_hz: 0 while it is not connected, or the motion sensor is off.
    eeg_rate_hz: float = 0.0
    motion_rate_hz: float = 0.0
    is_virtual: bool = False
    # From the headset's own list; empty while it is not connected.
    electrodes: tuple[str, ...] = ()

    @property
    def is_connected(self) -> bool:
        """Whether a session is possible."""
        return self.status == "connected"


@dataclass(frozen=True, slots=True)
class SessionState:
    """A session of this application."""

    session_id: str
    status: str
    headset_id: str = ""

    @property
    def is_active(self) -> bool:
        """Whether it may subscribe to the licensed streams."""
        return self.status == "activated"

    @property
    def is_closed(self) -> bool:
        """Whether it has ended."""
        return self.status == "closed"


@dataclass(frozen=True, slots=True)
class Subscription:
    """Outcome of ``subscribe``."""

    layouts: Mapping[str, Layout] = field(default_factory=dict[str, Layout])  # Columns by stream.
    failures: Mapping[str, int] = field(default_factory=dict[str, int])  # Error code by stream.
    session_id: str = ""  # Session id in the streams' data; empty if not given.


def version(result: object) -> str:
    """Parse ``getCortexInfo``."""
    return text_of(object_of(result).get("version"))


def login(result: object) -> Login:
    """Parse ``getUserLogin``."""
    users = [object_of(user) for user in list_of(result)]
    if not users:
        return Login(logged_in=False)
    user = users[0]
    current, logged_in = user.get("currentOSUId"), user.get("loggedInOSUId")
    return Login(logged_in=True, same_os_user=not (current and logged_in) or current == logged_in)


def access_granted(result: object) -> bool:
    """Parse ``hasAccessRight`` or ``requestAccess``."""
    return object_of(result).get("accessGranted") is True


def token(result: object) -> str:
    """Parse ``authorize``.

    Raises
    ------
    ProtocolError
        ``GARBAGE``.
    """
    return _required(object_of(result).get("cortexToken"), "a token")


def licence(result: object) -> Licence:
    """Parse the answer to ``getLicenseInfo``; a scope that it lacks is not licensed."""
    fields = object_of(object_of(result).get("license"))
    scopes = frozenset(text_of(each) for each in list_of(fields.get("scopes")))
    return Licence(scopes, expired=fields.get("expired") is True)


def eula_missing(result: object) -> bool:
    """Whether ``authorize`` reports that the licence agreement was not accepted."""
    return bool(object_of(result).get("warning"))


def headsets(result: object) -> list[Headset]:
    """Parse ``queryHeadsets``, without entries that have no id."""
    read = [_headset(object_of(each)) for each in list_of(result)]
    return [headset for headset in read if headset.headset_id]


def session(result: object) -> SessionState:
    """Parse ``createSession`` or ``updateSession``.

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
    """Parse ``querySessions``, without entries that have no id."""
    return [session(each) for each in list_of(result) if text_of(object_of(each).get("id"))]


def subscription(result: object) -> Subscription:
    """Parse ``subscribe``; a stream without valid columns counts as failed with code 0."""
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
