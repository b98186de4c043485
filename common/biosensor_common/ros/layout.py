"""Lays the numbers of a message out as channels.

A type says how many numbers a message has, except for sequences: of those the first message
tells the length. Where a message has a list of names beside its sequences, as the joints of
``JointState``, they label the channels.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter, itemgetter
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.lsl_header import MAX_CHANNELS
from biosensor_common.ros.fields import NAMES, Field, FieldKind
from biosensor_common.ros.quantities import NOTHING_KNOWN, channel_type

RosMessage = Any
"""An object with the fields of its type as attributes, of rclpy or of a reader of bags."""

_EXACT_UP_TO = 2.0**53
_PLACE = re.compile(r"\[(\d+)\]")


class LayoutChangedError(Exception):
    """A message has other sequences than the one that the layout was made from."""


class Channel(NamedTuple):
    """One number of a message.

    Attributes
    ----------
    path
        Where it is: ``position[0]``.
    label
        The same, with the element's name where it has one: ``panda_joint1.position``.
    values
        Names of its values, if the type enumerates them.
    """

    path: str
    label: str
    unit: str
    kind: str
    values: Mapping[int, str]
    is_wide: bool = False


class _Before(NamedTuple):
    """What stands before a field that is inside of another one."""

    path: str = ""
    label: str = ""


class _Part(Protocol):
    """Some of the numbers of a message."""

    def read(self, message: RosMessage, values: list[float]) -> None:
        """Append them; raises LayoutChangedError if there are others than there were."""
        ...


class _Scalars:
    """Fields that are no arrays, one after the other."""

    def __init__(self, fields: Sequence[Field]) -> None:
        get: Callable[[RosMessage], Any] = attrgetter(*(each.path for each in fields))
        # Of one path it returns the value, of several a tuple.
        self._get: Callable[[RosMessage], tuple[Any, ...]] = (
            get if len(fields) > 1 else lambda message: (get(message),)
        )
        self._other = [
            (place, each.kind)
            for place, each in enumerate(fields)
            if each.kind is not FieldKind.NUMBER
        ]

    def read(self, message: RosMessage, values: list[float]) -> None:
        begin = len(values)
        values.extend(self._get(message))
        for place, kind in self._other:
            values[begin + place] = _number(values[begin + place], kind)


class _Numbers:
    """An array of numbers; of one whose elements are wanted by number, missing ones are NaN."""

    def __init__(self, field: Field, length: int, most: int | None) -> None:
        self._get = attrgetter(field.path)
        self._kind, self._length, self._most = field.kind, length, most

    def read(self, message: RosMessage, values: list[float]) -> None:
        got = _first(self._get(message), self._most)
        if len(got) == self._length:
            if self._kind is FieldKind.NUMBER:
                # An array of numpy would be taken for numbers of numpy, which is slow.
                values.extend(got.tolist() if hasattr(got, "tolist") else got)
            else:
                values.extend(_number(each, self._kind) for each in got)
        elif not len(got) or (self._most is not None and len(got) < self._length):
            values.extend(_number(each, self._kind) for each in got)
            values.extend([math.nan] * (self._length - len(got)))
        else:
            raise LayoutChangedError


class _Messages:
    """An array of messages."""

    def __init__(
        self, field: Field, elements: Sequence[Sequence[_Part]], width: int, most: int | None
    ) -> None:
        self._get = attrgetter(field.path)
        self._elements, self._width, self._most = elements, width, most

    def read(self, message: RosMessage, values: list[float]) -> None:
        got = _first(self._get(message), self._most)
        may_be_fewer = self._most is not None or not len(got)
        if len(got) > len(self._elements) or (len(got) < len(self._elements) and not may_be_fewer):
            raise LayoutChangedError
        end = len(values) + self._width
        for element, parts in zip(got, self._elements, strict=False):
            for part in parts:
                part.read(element, values)
        values.extend([math.nan] * (end - len(values)))


class _Names:
    """Names that label channels; they stay as they were."""

    def __init__(self, get: attrgetter[Any], names: Sequence[str]) -> None:
        self._get, self._names = get, list(names)

    def read(self, message: RosMessage, values: list[float]) -> None:
        del values
        got = list(self._get(message))
        if got and got != self._names:
            raise LayoutChangedError


class Layout:
    """The channels of one stream, and how to read them from a message.

    Parameters
    ----------
    fields
        Of the message's type.
    message
        Whose sequences give the lengths.
    wanted
        Fields, groups of fields or labels to send; all of them if there is none.

    Raises
    ------
    SpecError
        ``INVALID`` if nothing fits what is wanted, ``TOO_LARGE`` if there are too many channels.
    """

    def __init__(
        self,
        fields: Sequence[Field],
        message: RosMessage,
        wanted: Sequence[str] = (),
    ) -> None:
        found: list[Channel] = []
        most = {each.path: _most_wanted(each, wanted) for each in fields}
        self._parts = _read_parts(fields, message, _Before(), found, most)
        places = [place for place, each in enumerate(found) if _is_wanted(each, wanted)]
        _check(fields, found, places, wanted)
        self.channels = tuple(found[place] for place in places)
        is_all = len(places) == len(found)
        self._pick = None if is_all or not places else itemgetter(*places)
        self._wide = [place for place, each in enumerate(self.channels) if each.is_wide]

    @property
    def labels(self) -> tuple[str, ...]:
        """One a channel."""
        return tuple(each.label for each in self.channels)

    def read(self, message: RosMessage) -> Sequence[float]:
        """Return a message's numbers, one a channel; NaN for those of a sequence that is empty.

        Raises
        ------
        LayoutChangedError
            If the message has other sequences, or other names, than the first one.
        """
        values: list[float] = []
        for part in self._parts:
            part.read(message, values)
        if self._pick is None:
            return values
        picked = self._pick(values)
        return picked if len(self.channels) > 1 else (picked,)

    def inexact(self, values: Sequence[float]) -> str:
        """Return the label of a channel whose integer a float of 64 bits does not hold, if any."""
        for place in self._wide:
            if abs(values[place]) > _EXACT_UP_TO:
                return self.channels[place].label
        return ""


def _channel_of(field: Field, path: str, label: str) -> Channel:
    """Return the channel of a field, or of an element of one."""
    measured = field.measured
    kind = NOTHING_KNOWN.kind if measured is NOTHING_KNOWN else channel_type(measured, field.name)
    return Channel(path, label, measured.unit, kind, field.values, field.is_wide)


def _read_parts(
    fields: Sequence[Field],
    message: RosMessage,
    before: _Before,
    found: list[Channel],
    most: Mapping[str, int | None] = MappingProxyType({}),
) -> list[_Part]:
    parts: list[_Part] = []
    scalars: list[Field] = []
    names = _names_in(fields, message)
    if names:
        parts.append(_Names(*names))
    for each in fields:
        if each.kind is FieldKind.TEXT:
            continue  # nothing is dropped: text goes out as markers
        if not each.is_array:
            found.append(_channel_of(each, before.path + each.path, before.label + each.path))
            scalars.append(each)
            continue  # nothing is dropped: it is a part by now
        if scalars:
            parts.append(_Scalars(scalars))
            scalars = []
        own = names[1] if names else ()
        parts.append(_array_part(each, message, before, found, own, most.get(each.path)))
    return [*parts, _Scalars(scalars)] if scalars else parts


def _array_part(
    field: Field,
    message: RosMessage,
    before: _Before,
    found: list[Channel],
    names: Sequence[str],
    most: int | None,
) -> _Part:
    present = attrgetter(field.path)(message)
    elements = _first(present, most)
    path, label = before.path + field.path, before.label + field.path
    # What has sequences of its own is no single joint, but a point of all of them.
    is_one_each = not any(inside.is_array for inside in field.elements)
    has_names = is_one_each and len(names) == len(present)
    group = label.removesuffix(field.name)
    begin = len(found)
    inside: list[list[_Part]] = []
    for place, element in enumerate(elements):
        at = f"{path}[{place}]"
        named = f"{group}{names[place]}.{field.name}" if has_names else f"{label}[{place}]"
        if field.kind is FieldKind.MESSAGE:
            deeper = _Before(f"{at}.", f"{named}.")
            inside.append(_read_parts(field.elements, element, deeper, found))
        else:
            found.append(_channel_of(field, at, named))
    if field.kind is FieldKind.MESSAGE:
        return _Messages(field, inside, len(found) - begin, most)
    return _Numbers(field, len(elements), most)


def _most_wanted(field: Field, wanted: Sequence[str]) -> int | None:
    """Return how many elements of an array are read, if only some are wanted by their number."""
    inside = [each.removeprefix(field.path) for each in wanted if is_part(each, field.path)]
    places = [int(found[1]) for each in inside if (found := _PLACE.match(each))]
    return max(places) + 1 if places and len(places) == len(inside) else None


def _first(elements: Any, most: int | None) -> Any:  # noqa: ANN401 - of any type
    return elements if most is None else elements[:most]


def _names_in(
    fields: Sequence[Field], message: RosMessage
) -> tuple[attrgetter[Any], list[str]] | None:
    """Return the names that a message gives the elements of its sequences, if it does."""
    for each in fields:
        if each.kind is FieldKind.TEXT and each.is_array and each.name in NAMES:
            get = attrgetter(each.path)
            names = list(get(message))
            is_one_each = all(names) and len(set(names)) == len(names)
            return (get, names) if names and is_one_each else None
    return None  # nothing is dropped: names are labels only


def _is_wanted(channel: Channel, wanted: Sequence[str]) -> bool:
    return not wanted or any(
        is_part(channel.path, each) or is_part(channel.label, each) for each in wanted
    )


def is_part(path: str, group: str) -> bool:
    """Whether a path is another one, or inside of it."""
    return path == group or (path.startswith(group) and path[len(group)] in ".[")


def _check(
    fields: Sequence[Field], found: Sequence[Channel], places: Sequence[int], wanted: Sequence[str]
) -> None:
    for each in wanted:
        group = each.split("[")[0]  # A sequence that is empty today is a field, too.
        is_field = any(is_part(f.path, group) or is_part(group, f.path) for f in fields)
        if found and not is_field and not any(_is_wanted(channel, [each]) for channel in found):
            known = ", ".join(dict.fromkeys(channel.path.split("[")[0] for channel in found))
            message = f"there is no number {each!r}; there are {known[:300]}"
            raise SpecError(SpecReason.INVALID, message)
    if len(places) > MAX_CHANNELS:
        message = (
            f"{len(places)} numbers are more than the {MAX_CHANNELS} channels that a stream can"
            " have; name the fields that you want"
        )
        raise SpecError(SpecReason.TOO_LARGE, message)


def _number(value: Any, kind: FieldKind) -> float:  # noqa: ANN401 - by its kind
    if kind is FieldKind.TIME:
        return value.sec + value.nanosec * 1e-9
    return float(value[0]) if isinstance(value, bytes) else value
