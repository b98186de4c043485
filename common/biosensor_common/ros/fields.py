"""Lists the fields of a message type, which rclpy or a bag file defines."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum, unique
from typing import NamedTuple, Protocol

from biosensor_common.ros.quantities import NOTHING_KNOWN, TIME, Quantity, quantity

HEADER = "header"
HEADER_TYPE = "std_msgs/msg/Header"
NAMES = ("name", "names", "joint_names")
"""Lists of text that name the elements of the other sequences of their message."""
# Dummy field of messages without fields in Python.
_NO_FIELD = "structure_needs_at_least_one_member"
_LAYOUT = "/MultiArrayLayout"
"""Layout of a MultiArray; its labels are not text for markers."""
_CLOUDS = {"sensor_msgs/msg/PointCloud": "points"}
"""Types of bulk data that are not byte arrays."""
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_TEXTS = ("string", "wstring")
_WIDE = ("int64", "uint64")
# A ``byte`` of the definition is called ``octet`` by rclpy and ``byte`` by the bag library.
_BYTE = ("octet", "byte")
_BYTES = (*_BYTE, "uint8", "int8", "char")


class Slot(NamedTuple):
    """One entry of a message's definition.

    Attributes
    ----------
    base
        ``float64``, ``string`` and so on; empty for a message.
    message
        Definition of a nested message; None otherwise.
    size
        Length of a fixed array; None for a sequence; 1 for a single value.
    has_limit
        Whether it is a bounded sequence.
    values
        Names of its values, if the type has constants for them.
    """

    name: str
    base: str = ""
    message: Definition | None = None
    size: int | None = 1
    is_array: bool = False
    has_limit: bool = False
    values: Mapping[int, str] = {}


class Definition(Protocol):
    """The definition of a message type."""

    @property
    def name(self) -> str:
        """Full name of the type: ``sensor_msgs/msg/JointState``."""
        ...

    def slots(self) -> Iterable[Slot]:
        """Return the entries in their order."""
        ...


@unique
class FieldKind(Enum):
    """Kind of a field's values."""

    NUMBER = "number"
    """A number; booleans are 0 and 1."""
    BYTE = "byte"
    """A ``byte`` of the definition, which Python may represent as ``bytes``."""
    TIME = "time"
    """Seconds and nanoseconds."""
    TEXT = "text"
    MESSAGE = "message"
    """An array of messages, whose elements have fields."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field, or an array of them.

    Attributes
    ----------
    path
        Attribute path within the message: ``pose.pose.position.x``.
    size
        Length of a fixed array; None for a sequence, whose length varies; 1 for a single value.
    measured
        Quantity that the field measures.
    is_wide
        Whether a 64-bit float cannot represent all of its values.
    is_blob
        Whether it is an unbounded sequence of bytes: an image, a point cloud.
    elements
        Fields of each element of an array of messages.
    values
        Names of the values, if the field is an enumeration.
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
    """Return the fields of a type in their order, with nested messages flattened.

    The message's own header and the layout of a MultiArray are left out.
    """
    return tuple(_walk(definition, "", NOTHING_KNOWN))


def has_header(definition: Definition) -> bool:
    """Whether messages of a type have a stamped header."""
    return any(_is_header(slot) for slot in definition.slots())


def bulk_of(definition: Definition) -> str:
    """Return the name of a field with bulk data, such as images or point clouds; else empty.

    Bytes in a MultiArray are not bulk data: they are numbers that somebody chose to send.
    """
    if any(_is_layout(slot) for slot in definition.slots()):
        return ""
    for each in fields_of(definition):
        if any(inside.is_blob for inside in all_fields((each,))):
            return each.path
    return _CLOUDS.get(definition.name, "")


def all_fields(fields: tuple[Field, ...]) -> Iterator[Field]:
    """Iterate over fields, including those of array elements."""
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
