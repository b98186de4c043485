"""Reads the fields of a message type from its rclpy class."""

from __future__ import annotations

from collections.abc import Iterator
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
from biosensor_common.ros import fields
from biosensor_common.ros.fields import HEADER, Field, Slot

FRAMES = ("frame_id", "child_frame_id")
"""Text fields that name frames; they belong into the header of a stream."""


def type_name(message_class: type[Any]) -> str:
    """Return the ROS name of a class: ``sensor_msgs/msg/JointState``."""
    package = message_class.__module__.split(".")[0]
    return f"{package}/msg/{message_class.__name__}"


def message_class(name: str) -> type[Any]:
    """Import a message type.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if the name is not valid, ``NOT_FOUND`` if the type is not installed.
    """
    package, _, rest = name.partition("/")
    kind = rest.removeprefix("msg/")
    if not (package.isidentifier() and kind.isidentifier()):
        message = f"{name!r} is not a message type such as std_msgs/msg/String"
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
    """Return the fields of a type; see `biosensor_common.ros.fields.fields_of`."""
    return fields.fields_of(_Class(message_class))


@cache
def has_header(message_class: type[Any]) -> bool:
    """Whether messages of a type have a stamped header."""
    return fields.has_header(_Class(message_class))


@cache
def bulk_of(message_class: type[Any]) -> str:
    """Return the name of a field with bulk data, such as images or point clouds; else empty."""
    return fields.bulk_of(_Class(message_class))


class FramedList(NamedTuple):
    """The only field of a message: a list of elements between pairs of frames."""

    name: str
    element: type[Any]  # Class of the elements, which have a header and a `child_frame_id`.


@cache
def framed_list(message_class: type[Any]) -> FramedList | None:
    """Return the list of a type such as ``tf2_msgs/msg/TFMessage``; None for other types."""
    slots = [each for each in _Class(message_class).slots() if each.name != HEADER]
    if len(slots) != 1 or not slots[0].is_array or not isinstance(slots[0].message, _Class):
        return None
    element = slots[0].message.message_class
    is_framed = FRAMES[1] in element.get_fields_and_field_types() and has_header(element)
    return FramedList(slots[0].name, element) if is_framed else None


class _Class:
    """The definition of a message, from its rclpy class."""

    def __init__(self, message_class: type[Any]) -> None:
        self.message_class = message_class

    @property
    def name(self) -> str:
        return type_name(self.message_class)

    def slots(self) -> Iterator[Slot]:
        names = self.message_class.get_fields_and_field_types()
        for name, kind in zip(names, self.message_class.SLOT_TYPES, strict=True):
            is_array = isinstance(kind, AbstractNestedType)
            value: AbstractType = kind.value_type if is_array else kind
            size = kind.size if isinstance(kind, Array) else None
            yield Slot(
                name,
                _base(value),
                _Class(_class_of(value)) if isinstance(value, NamespacedType) else None,
                size=size if is_array else 1,
                is_array=is_array,
                has_limit=is_array and not isinstance(kind, UnboundedSequence),
                values=_constants(self.message_class, name),
            )


def _base(value: AbstractType) -> str:
    if isinstance(value, AbstractGenericString):
        return "string"
    return value.typename if isinstance(value, BasicType) else ""


def _class_of(slot: NamespacedType) -> type[Any]:
    return getattr(import_module(".".join(slot.namespaces)), slot.name)


def _constants(owner: type[Any], name: str) -> dict[int, str]:
    """Return the constants whose names begin with the field's name, as in enumerations."""
    prefix = f"{name.upper()}_"
    # `STATUS__DEFAULT` is the field's default, not the name of a value.
    constants = (
        each
        for each in vars(type(owner))
        if each.startswith(prefix) and not each.endswith("__DEFAULT")
    )
    named = {getattr(owner, each): each.removeprefix(prefix) for each in constants}
    return {value: each for value, each in named.items() if type(value) is int}


def frames_of(message: object) -> dict[str, str]:
    """Return the frames of a message, from its header and its own field."""
    holders = (getattr(message, HEADER, None), message)
    return {
        name: str(getattr(holder, name))
        for name in FRAMES
        for holder in holders
        if hasattr(holder, name)
    }
