"""Finds out what fields a message type has, from its class."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum, unique
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractNestedType,
    AbstractType,
    Array,
    BasicType,
    NamespacedType,
    UnboundedSequence,
)

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.ros_quantities import NOTHING_KNOWN, TIME, Quantity, quantity

HEADER = "header"
HEADER_TYPE = "std_msgs/msg/Header"
FRAMES = ("frame_id", "child_frame_id")
"""Text that says where something is measured; it belongs into the header of a stream."""
NAMES = ("name", "names", "joint_names")
"""Lists of text that name the elements of the other sequences beside them."""
# What a message without fields has in Python.
_NO_FIELD = "structure_needs_at_least_one_member"
_LAYOUT = "/MultiArrayLayout"
"""How a MultiArray's numbers are to be folded; its labels make no report of it."""
_CLOUDS = {"sensor_msgs/msg/PointCloud": "points"}
"""Bulk data that is no bytes."""
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_WIDE = ("int64", "uint64")
_BYTES = ("uint8", "int8", "octet", "char")


@unique
class FieldKind(Enum):
    """What one value of a field is."""

    NUMBER = "number"
    """Booleans are numbers, too: 0 and 1."""
    BYTE = "byte"
    """A ``byte`` of the message's definition, which Python has as ``bytes``."""
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
    is_array
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


def type_name(message_class: type[Any]) -> str:
    """Return a class's name as ROS has it: ``sensor_msgs/msg/JointState``."""
    package = message_class.__module__.split(".")[0]
    return f"{package}/msg/{message_class.__name__}"


def message_class(name: str) -> type[Any]:
    """Import a message type.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if it is no name of a type, ``NOT_FOUND`` if it is not installed here.
    """
    package, _, rest = name.partition("/")
    kind = rest.removeprefix("msg/")
    if not (package.isidentifier() and kind.isidentifier()):
        message = f"{name!r} is no message type such as std_msgs/msg/String"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    try:
        return getattr(import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError) as error:
        message = (
            f"the message type {name} is not installed on this computer; install its package, or"
            " source the workspace that has it"
        )
        raise ConfigError(ConfigReason.NOT_FOUND, message) from error


@cache
def fields_of(message_class: type[Any]) -> tuple[Field, ...]:
    """Return the fields of a type, messages inside it opened, in the order of its definition.

    The header of the message itself is left out, and the layout of a MultiArray.
    """
    return tuple(_walk(message_class, "", NOTHING_KNOWN))


@cache
def has_header(message_class: type[Any]) -> bool:
    """Whether messages of a type have a header, with a stamp."""
    slot = dict(_slots(message_class)).get(HEADER)
    return isinstance(slot, NamespacedType) and _name_of(slot) == HEADER_TYPE


@cache
def bulk_of(message_class: type[Any]) -> str:
    """Return the field with an image, a cloud of points or the like; empty without any.

    Bytes in a MultiArray are numbers that somebody chose to send.
    """
    if any(_is_layout(slot) for _, slot in _slots(message_class)):
        return ""
    blobs = (each.path for each in fields_of(message_class) if each.is_blob)
    return next(blobs, _CLOUDS.get(type_name(message_class), ""))


class FramedList(NamedTuple):
    """The only field of a message, a list of what is measured between pairs of frames.

    Attributes
    ----------
    element
        Class of what is in it; it has a header and a ``child_frame_id``.
    """

    name: str
    element: type[Any]


@cache
def framed_list(message_class: type[Any]) -> FramedList | None:
    """Return the list of a type such as ``tf2_msgs/msg/TFMessage``."""
    slots = [(name, slot) for name, slot in _slots(message_class) if name != HEADER]
    if len(slots) != 1:
        return None
    name, slot = slots[0]
    if not isinstance(slot, AbstractNestedType) or not isinstance(slot.value_type, NamespacedType):
        return None
    element = _class_of(slot.value_type)
    is_framed = FRAMES[1] in element.get_fields_and_field_types() and has_header(element)
    return FramedList(name, element) if is_framed else None


def all_fields(fields: tuple[Field, ...]) -> Iterator[Field]:
    """Go through fields and through those of the elements of arrays."""
    for each in fields:
        yield each
        yield from all_fields(each.elements)


def _slots(message_class: type[Any]) -> Iterator[tuple[str, AbstractType]]:
    names = message_class.get_fields_and_field_types()
    for name, slot in zip(names, message_class.SLOT_TYPES, strict=True):
        if name != _NO_FIELD:
            yield name, slot


def _walk(message_class: type[Any], before: str, inherited: Quantity) -> Iterator[Field]:
    owner = type_name(message_class)
    for name, slot in _slots(message_class):
        is_header = not before and name == HEADER and has_header(message_class)
        if is_header or _is_layout(slot):
            continue
        measured = quantity(owner, name) or inherited
        path = f"{before}{name}"
        if isinstance(slot, AbstractNestedType):
            yield _array(message_class, path, slot, measured)
        elif isinstance(slot, NamespacedType) and _name_of(slot) not in _TIMES:
            yield from _walk(_class_of(slot), f"{path}.", measured)
        else:
            yield _scalar(message_class, path, slot, measured)


def _scalar(owner: type[Any], path: str, slot: AbstractType, measured: Quantity) -> Field:
    kind = _kind(slot)
    return Field(
        path,
        kind,
        measured=TIME if kind is FieldKind.TIME else measured,
        is_wide=_is(slot, *_WIDE),
        values=_constants(owner, path) if kind is FieldKind.NUMBER else {},
    )


def _array(owner: type[Any], path: str, slot: AbstractNestedType, measured: Quantity) -> Field:
    value = slot.value_type
    kind = _kind(value)
    is_message = kind is FieldKind.MESSAGE
    assert not is_message or isinstance(value, NamespacedType)
    elements = (
        tuple(_walk(_class_of(value), "", measured)) if isinstance(value, NamespacedType) else ()
    )
    return Field(
        path,
        kind,
        size=slot.size if isinstance(slot, Array) else None,
        is_array=True,
        measured=TIME if kind is FieldKind.TIME else measured,
        is_wide=_is(value, *_WIDE),
        is_blob=isinstance(slot, UnboundedSequence) and _is(value, *_BYTES),
        elements=elements if is_message else (),
        values=_constants(owner, path) if kind is FieldKind.NUMBER else {},
    )


def _kind(slot: AbstractType) -> FieldKind:
    if isinstance(slot, AbstractGenericString):
        return FieldKind.TEXT
    if isinstance(slot, NamespacedType):
        return FieldKind.TIME if _name_of(slot) in _TIMES else FieldKind.MESSAGE
    return FieldKind.BYTE if _is(slot, "octet") else FieldKind.NUMBER


def _is(slot: AbstractType, *names: str) -> bool:
    return isinstance(slot, BasicType) and slot.typename in names


def _is_layout(slot: AbstractType) -> bool:
    return isinstance(slot, NamespacedType) and _name_of(slot).endswith(_LAYOUT)


def _name_of(slot: NamespacedType) -> str:
    return "/".join([*slot.namespaces, slot.name])


def _class_of(slot: NamespacedType) -> type[Any]:
    return getattr(import_module(".".join(slot.namespaces)), slot.name)


def _constants(owner: type[Any], path: str) -> dict[int, str]:
    """Return the constants whose names begin with the field's, which is how types enumerate."""
    prefix = f"{path.rpartition('.')[2].upper()}_"
    constants = (name for name in vars(type(owner)) if name.startswith(prefix))
    named = {getattr(owner, name): name.removeprefix(prefix) for name in constants}
    return {value: name for value, name in named.items() if type(value) is int}


def frames_of(message: object) -> dict[str, str]:
    """Return the frames that a message names, in its header or itself."""
    holders = (getattr(message, HEADER, None), message)
    return {
        name: str(getattr(holder, name))
        for name in FRAMES
        for holder in holders
        if hasattr(holder, name)
    }
