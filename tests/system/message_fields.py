"""Any ROS message as plain data, and back: the way of a message through JSON.

``python -m tests.system.message_fields TYPE FIELDS``: serialize a message and read it again. FIELDS
is a JSON object. It prints, as one, the fields of what was read, and the fields' types as the
generated class names them.
"""

from __future__ import annotations

import importlib
import json
import sys
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


def main() -> None:
    from rclpy import serialization  # noqa: PLC0415 - the rest needs no ROS

    name, fields = sys.argv[1:]
    kind = message_class(name)
    written: bytes = serialization.serialize_message(message_of(kind, json.loads(fields)))
    read: Any = serialization.deserialize_message(written, kind)
    print(json.dumps({"fields": fields_of(read), "types": kind.get_fields_and_field_types()}))


if __name__ == "__main__":
    main()
