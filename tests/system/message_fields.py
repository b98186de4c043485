"""Any ROS message as plain data, and back: the way of a message through JSON."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any


def message_class(name: str) -> type[Any]:
    """Import a message's class by its ROS name, such as ``std_msgs/msg/Header``."""
    package, folder, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), kind)


def fields_of(message: Any) -> dict[str, Any]:
    """Return all fields, sequences as lists and messages as mappings."""
    return {name: _plain(getattr(message, name)) for name in message.get_fields_and_field_types()}


def message_of(kind: type[Any], fields: Mapping[str, Any]) -> Any:
    """Make a message of its fields; those that are not there keep their defaults.

    Raises
    ------
    AttributeError
        If the message has no such field.
    """
    message = kind()
    for name, value in fields.items():
        present: Any = getattr(message, name)
        nested = _is_message(present)
        setattr(message, name, message_of(present.__class__, value) if nested else value)
    return message


def _plain(value: Any) -> Any:
    if _is_message(value):
        return fields_of(value)
    if isinstance(value, (bool, int, float, str)):
        return value
    return [_plain(element) for element in value]


def _is_message(value: Any) -> bool:
    return hasattr(value, "get_fields_and_field_types")
