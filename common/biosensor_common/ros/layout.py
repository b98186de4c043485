"""Maps the numbers of a message to channels.

The type defines how many numbers a message has, except for sequences, whose length is taken from
the first message. If a message has a list of names for its sequences, such as the joints of
``JointState``, these label the channels.
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
from biosensor_common.ros.fields import NAMES, NOTHING_KNOWN, Field, FieldKind, channel_type

RosMessage = Any
"""An object with its fields as attributes, from rclpy or a bag reader."""

_EXACT_UP_TO = 2.0**53
_PLACE = re.compile(r"\[(\d+)\]")


class LayoutChangedError(Exception):
    """A message's sequences differ from those for which the layout was made."""


class Channel(NamedTuple):
    """One number of a message.

    Attributes
    ----------
    path
        Path within the message: ``position[0]``.
    label
        Path with the element's name, if it has one: ``panda_joint1.position``.
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
    """Prefix of the fields of a nested message."""

    path: str = ""
    label: str = ""


class _Part(Protocol):
    """A group of a message's numbers, which are read together."""

    def read(self, message: RosMessage, values: list[float]) -> None:
        """Append the numbers to *values*; raises LayoutChangedError if their count has changed."""
        ...


class _Scalars:
    """Consecutive fields that are not arrays."""

    def __init__(self, fields: Sequence[Field]) -> None:
        get: Callable[[RosMessage], Any] = attrgetter(*(each.path for each in fields))
        # attrgetter returns a value for one path, and a tuple for several.
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
    """An array of numbers; elements that were requested by index and are missing are NaN."""

    def __init__(self, field: Field, length: int, most: int | None) -> None:
        self._get = attrgetter(field.path)
        self._kind, self._length, self._most = field.kind, length, most

    def read(self, message: RosMessage, values: list[float]) -> None:
        got = _first(self._get(message), self._most)
        if len(got) == self._length:
            if self._kind is FieldKind.NUMBER:
                # Iterating over a numpy array would yield numpy scalars, which are slow.
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
    """Names that label channels; they must not change."""

    def __init__(self, get: attrgetter[Any], names: Sequence[str]) -> None:
        self._get, self._names = get, list(names)

    def read(self, message: RosMessage, values: list[float]) -> None:
        del values
        got = list(self._get(message))
        if got and got != self._names:
            raise LayoutChangedError


class Layout:
    """The channels of one stream, and how they are read from a message.

    Parameters
    ----------
    fields
        Fields of the message's type.
    message
        Message whose sequences define the lengths.
    wanted
        Fields, groups of fields or labels to send; all if empty.

    Raises
    ------
    SpecError
        ``INVALID`` if a requested field does not exist, ``TOO_LARGE`` for too many channels.
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
        """Labels, one per channel."""
        return tuple(each.label for each in self.channels)

    def read(self, message: RosMessage) -> Sequence[float]:
        """Return a message's numbers, one per channel; NaN for those of an empty sequence.

        Raises
        ------
        LayoutChangedError
            If the lengths of its sequences, or its names, differ from the first message's.
        """
        values: list[float] = []
        for part in self._parts:
            part.read(message, values)
        if self._pick is None:
            return values
        picked = self._pick(values)
        return picked if len(self.channels) > 1 else (picked,)

    def inexact(self, values: Sequence[float]) -> str:
        """Return the label of a channel whose integer a 64-bit float cannot represent, if any."""
        for place in self._wide:
            if abs(values[place]) > _EXACT_UP_TO:
                return self.channels[place].label
        return ""


def _channel_of(field: Field, path: str, label: str) -> Channel:
    """Return the channel of a field or of an array element."""
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
    # An element with sequences is not one joint but a point with all joints.
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
    """Return how many elements of an array are read, if only some are requested by index."""
    inside = [each.removeprefix(field.path) for each in wanted if is_part(each, field.path)]
    places = [int(found[1]) for each in inside if (found := _PLACE.match(each))]
    return max(places) + 1 if places and len(places) == len(inside) else None


def _first(elements: Any, most: int | None) -> Any:  # noqa: ANN401 - of any type
    return elements if most is None else elements[:most]


def _names_in(
    fields: Sequence[Field], message: RosMessage
) -> tuple[attrgetter[Any], list[str]] | None:
    """Return the names of the elements of a message's sequences, if it has any."""
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
    """Whether a path equals another one or is nested in it."""
    return path == group or (path.startswith(group) and path[len(group)] in ".[")


def _check(
    fields: Sequence[Field], found: Sequence[Channel], places: Sequence[int], wanted: Sequence[str]
) -> None:
    for each in wanted:
        group = each.split("[")[0]  # A sequence that is empty in this message is a field, too.
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
