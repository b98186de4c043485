"""Lays the numbers of any message out as channels, by its definition.

Sequences take their shape at the first message. Where a message names the elements of its
sequences, as ``JointState`` its joints, the names are in the labels. Units are those of REP 103,
where the type says what it measures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype

from biosensor_common.lsl_header import MAX_CHANNELS
from biosensor_common.ros_quantities import NOTHING_KNOWN, TIME, Quantity, quantity
from biosensor_gateway.recording.bag.errors import UnsuitableError
from biosensor_gateway.recording.bag.types import MessageType

HEADER = "std_msgs/msg/Header"
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_NAMES = ("name", "names", "joint_names")
_BYTES = ("uint8", "int8", "byte", "char", "octet")
_TEXTS = ("string", "wstring")
# What a message without fields has.
_NO_FIELD = "structure_needs_at_least_one_member"

Read = Callable[[Any, list[float]], None]
"""Appends some numbers of a message."""


class LayoutChangedError(Exception):
    """A message has sequences of another length, or of other names, than the first."""


class Layout(NamedTuple):
    """The channels of a message.

    Attributes
    ----------
    channels
        Label and unit of each: ``linear_acceleration.x``, ``panda_joint1.position``.
    """

    channels: tuple[tuple[str, str], ...]
    reads: tuple[Read, ...]

    def read(self, message: Any) -> list[float]:
        """Return the numbers, one a channel; NaN for those of a sequence that is empty.

        Raises
        ------
        LayoutChangedError
            If the message has another shape.
        """
        values: list[float] = []
        for read in self.reads:
            read(message, values)
        return values


def layout_of(kind: MessageType, message: Any) -> Layout:
    """Return the layout of messages like one of them; without channels if there are no numbers.

    Raises
    ------
    UnsuitableError
        If it holds bytes without a limit, such as an image, or more numbers than a stream can.
    """
    found: list[tuple[str, str]] = []
    reads = tuple(_walk(kind, kind.name, message, _Place(), found))
    if len(found) > MAX_CHANNELS:
        text = f"its {len(found)} numbers are more than the {MAX_CHANNELS} channels of a stream"
        raise UnsuitableError(text)
    return Layout(tuple(found), reads)


def has_header(kind: MessageType) -> bool:
    """Whether messages begin with a header that has a stamp."""
    return ("header", (Nodetype.NAME, HEADER)) in kind.fields(kind.name)


class _Place(NamedTuple):
    """Where a message is in the outermost one, what that is called, and what it measures."""

    path: str = ""
    label: str = ""
    measured: Quantity = NOTHING_KNOWN


def _walk(
    kind: MessageType,
    type_name: str,
    message: Any,
    place: _Place,
    found: list[tuple[str, str]],
) -> Iterator[Read]:
    """Give what reads the fields of a message."""
    names = _names_in(kind, type_name, message)
    if names:
        yield _same_names(f"{place.path}{names[0]}", names[1])
    for field, (node, what) in kind.fields(type_name):
        value = getattr(message, field)
        here, called = f"{place.path}{field}", f"{place.label}{field}"
        measured = quantity(type_name, field) or place.measured
        if node is Nodetype.NAME:
            if what == HEADER and not place.path:
                continue
            if what in _TIMES:
                found.append((called, TIME.unit))
                yield _time(here)
            else:
                inside = _Place(f"{here}.", f"{called}.", measured)
                yield from _walk(kind, what, value, inside, found)
        elif node is Nodetype.BASE:
            if what[0] not in _TEXTS and field != _NO_FIELD:
                found.append((called, measured.unit))
                yield _number(here)
        else:
            is_named = names and len(names[1]) == len(value) and _is_one_each(kind, what[0])
            told = names[1] if names and is_named else ()
            named = _Named(place.label, field, told, measured)
            yield from _array(kind, (node, what), value, here, named, found)


def _is_one_each(kind: MessageType, element: tuple[Nodetype, Any]) -> bool:
    """Whether the elements of an array have no sequences: those are points of all joints."""
    node, what = element
    if node is Nodetype.NAME:
        return all(_is_one_each(kind, inside) for _, inside in kind.fields(what))
    return node is Nodetype.BASE


class _Named(NamedTuple):
    """What to call the elements of an array, and what they measure."""

    group: str
    field: str
    names: Sequence[str]
    measured: Quantity

    def label(self, place: int) -> str:
        if self.names:
            return f"{self.group}{self.names[place]}.{self.field}"
        return f"{self.group}{self.field}[{place}]"


def _array(
    kind: MessageType,
    description: tuple[Nodetype, Any],
    value: Any,
    path: str,
    named: _Named,
    found: list[tuple[str, str]],
) -> Iterator[Read]:
    node, ((inner, what), bound) = description
    if inner is Nodetype.BASE:
        if what[0] in _TEXTS:
            return
        if node is Nodetype.SEQUENCE and not bound and what[0] in _BYTES:
            raise UnsuitableError(f"its field {path} holds bytes, not numbers")
        found.extend((named.label(place), named.measured.unit) for place in range(len(value)))
        yield _numbers(path, len(value))
        return
    before = len(found)
    elements: list[tuple[Read, ...]] = []
    for place, element in enumerate(value):
        called = named.label(place)
        if what in _TIMES:
            found.append((called, TIME.unit))
            elements.append((_time(""),))
        else:
            inside = _Place("", f"{called}.", named.measured)
            elements.append(tuple(_walk(kind, what, element, inside, found)))
    yield _messages(path, elements, len(found) - before)


def _names_in(
    kind: MessageType,
    type_name: str,
    message: Any,
) -> tuple[str, list[str]] | None:
    """Return the field by which a message names the elements of its sequences, and the names."""
    for field, (node, what) in kind.fields(type_name):
        is_texts = node is Nodetype.SEQUENCE and what[0][0] is Nodetype.BASE
        if is_texts and what[0][1][0] in _TEXTS and field in _NAMES:
            names = list(getattr(message, field))
            return (
                (field, names) if names and all(names) and len(set(names)) == len(names) else None
            )
    return None


def _same_names(path: str, names: list[str]) -> Read:
    get = attrgetter(path)

    def read(message: Any, values: list[float]) -> None:
        del values
        got = list(get(message))
        if got and got != names:
            raise LayoutChangedError

    return read


def _number(path: str) -> Read:
    get = attrgetter(path)
    return lambda message, values: values.append(float(get(message)))


def _time(path: str) -> Read:
    get: Callable[[Any], Any] = attrgetter(path) if path else lambda message: message

    def read(message: Any, values: list[float]) -> None:
        time = get(message)
        values.append(time.sec + time.nanosec * 1e-9)

    return read


def _numbers(path: str, length: int) -> Read:
    get = attrgetter(path)

    def read(message: Any, values: list[float]) -> None:
        got = get(message)
        if len(got) == length:
            values.extend(np.asarray(got, np.float64).tolist())
        elif not len(got):
            values.extend([math.nan] * length)
        else:
            raise LayoutChangedError

    return read


def _messages(path: str, elements: Sequence[Sequence[Read]], width: int) -> Read:
    get = attrgetter(path)

    def read(message: Any, values: list[float]) -> None:
        got = get(message)
        if not len(got):
            values.extend([math.nan] * width)
            return
        if len(got) != len(elements):
            raise LayoutChangedError
        for element, reads in zip(got, elements, strict=True):
            for each in reads:
                each(element, values)

    return read
