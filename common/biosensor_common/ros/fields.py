"""Finds the fields of a message type, from whatever defines it: a class of rclpy, or a bag."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum, unique
from typing import NamedTuple, Protocol

from biosensor_common.ros.quantities import NOTHING_KNOWN, TIME, Quantity, quantity

HEADER = "header"
HEADER_TYPE = "std_msgs/msg/Header"
NAMES = ("name", "names", "joint_names")
"""Lists of text that name the elements of the other sequences beside them."""
# What a message without fields has in Python.
_NO_FIELD = "structure_needs_at_least_one_member"
_LAYOUT = "/MultiArrayLayout"
"""How a MultiArray's numbers are to be folded; its labels make no report of it."""
_CLOUDS = {"sensor_msgs/msg/PointCloud": "points"}
"""Bulk data that is no bytes."""
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_TEXTS = ("string", "wstring")
_WIDE = ("int64", "uint64")
# Of the two libraries, one calls a ``byte`` of the definition ``octet`` and one calls it ``byte``.
_BYTE = ("octet", "byte")
_BYTES = (*_BYTE, "uint8", "int8", "char")


class Slot(NamedTuple):
    """One entry of a message's definition.

    Attributes
    ----------
    base
        ``float64``, ``string`` and so on; empty of a message.
    message
        The definition of what is inside; None of what is no message.
    size
        Of a fixed array; None of a sequence; 1 of what is no array.
    has_limit
        It is a sequence with a limit.
    values
        Names of its values, as far as the type has constants for them.
    """

    name: str
    base: str = ""
    message: Definition | None = None
    size: int | None = 1
    is_array: bool = False
    has_limit: bool = False
    values: Mapping[int, str] = {}


class Definition(Protocol):
    """A message type, as somebody defines it."""

    @property
    def name(self) -> str:
        """As ROS has it: ``sensor_msgs/msg/JointState``."""
        ...

    def slots(self) -> Iterable[Slot]:
        """Return its entries in their order."""
        ...


@unique
class FieldKind(Enum):
    """What one value of a field is."""

    NUMBER = "number"
    """Booleans are numbers, too: 0 and 1."""
    BYTE = "byte"
    """A ``byte`` of the message's definition, which Python may have as ``bytes``."""
    TIME = "time"
    """Seconds and nanoseconds."""
    TEXT = "text"
    MESSAGE = "message"
    """Of an array: each element has fields of its own."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field, or an array of them.

    Attributes
    ----------
    path
        Of attributes, from the message that it was found in: ``pose.pose.position.x``.
    size
        Of a fixed array; None of a sequence, whose size only a message tells; 1 of what is no
        array.
    measured
        What it measures.
    is_wide
        A float of 64 bits does not hold every value of it.
    is_blob
        A sequence of bytes without a limit: an image, a cloud of points.
    elements
        What each element has, in an array of messages.
    values
        Names of the values that the type has names for, as far as it is an enumeration.
    """

    path: str
    kind: FieldKind
    size: int | None = 1
    is_array: bool = False
    measured: Quantity = NOTHING_KNOWN
    is_wide: bool = False
    is_blob: bool = False
    elements: tuple[Field, ...] = ()
    values: Mapping[int, str] = field(default_factory=dict[int, str])

    @property
    def name(self) -> str:
        """The last part of the path."""
        return self.path.rpartition(".")[2]


def fields_of(definition: Definition) -> tuple[Field, ...]:
    """Return the fields of a type, messages inside it opened, in the order of its definition.

    The header of the message itself is left out, and the layout of a MultiArray.
    """
    return tuple(_walk(definition, "", NOTHING_KNOWN))


def has_header(definition: Definition) -> bool:
    """Whether messages of a type have a header, with a stamp."""
    return any(_is_header(slot) for slot in definition.slots())


def bulk_of(definition: Definition) -> str:
    """Return the field with images, clouds of points or the like; empty without any.

    Bytes in a MultiArray are numbers that somebody chose to send.
    """
    if any(_is_layout(slot) for slot in definition.slots()):
        return ""
    for each in fields_of(definition):
        if any(inside.is_blob for inside in all_fields((each,))):
            return each.path
    return _CLOUDS.get(definition.name, "")


def all_fields(fields: tuple[Field, ...]) -> Iterator[Field]:
    """Go through fields and through those of the elements of arrays."""
    for each in fields:
        yield each
        yield from all_fields(each.elements)


def _walk(definition: Definition, before: str, inherited: Quantity) -> Iterator[Field]:
    for slot in definition.slots():
        if (not before and _is_header(slot)) or _is_layout(slot) or slot.name == _NO_FIELD:
            continue
        measured = quantity(definition.name, slot.name) or inherited
        path = f"{before}{slot.name}"
        kind = _kind(slot)
        if kind is FieldKind.MESSAGE and not slot.is_array:
            assert slot.message is not None
            yield from _walk(slot.message, f"{path}.", measured)
        else:
            yield _field(slot, path, kind, measured)


def _field(slot: Slot, path: str, kind: FieldKind, measured: Quantity) -> Field:
    is_message = kind is FieldKind.MESSAGE
    return Field(
        path,
        kind,
        size=slot.size,
        is_array=slot.is_array,
        measured=TIME if kind is FieldKind.TIME else measured,
        is_wide=slot.base in _WIDE,
        is_blob=slot.size is None and not slot.has_limit and slot.base in _BYTES,
        elements=tuple(_walk(slot.message, "", measured)) if slot.message and is_message else (),
        values=slot.values if kind is FieldKind.NUMBER else {},
    )


def _kind(slot: Slot) -> FieldKind:
    if slot.message is not None:
        return FieldKind.TIME if slot.message.name in _TIMES else FieldKind.MESSAGE
    if slot.base in _TEXTS:
        return FieldKind.TEXT
    return FieldKind.BYTE if slot.base in _BYTE else FieldKind.NUMBER


def _is_header(slot: Slot) -> bool:
    is_header = slot.name == HEADER and not slot.is_array
    return is_header and slot.message is not None and slot.message.name == HEADER_TYPE


def _is_layout(slot: Slot) -> bool:
    return slot.message is not None and slot.message.name.endswith(_LAYOUT)
