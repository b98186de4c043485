"""``python -m tests.system.round_trip TYPE FIELDS``: serialize a message and read it again.

FIELDS is a JSON object. It prints, as one, the fields of what was read, and the fields'
types as the generated class names them.
"""

from __future__ import annotations

import json
import sys
from typing import Any

from rclpy import serialization

from tests.system.message_fields import fields_of, message_class, message_of


def main() -> None:
    name, fields = sys.argv[1:]
    kind = message_class(name)
    written: bytes = serialization.serialize_message(message_of(kind, json.loads(fields)))
    read: Any = serialization.deserialize_message(written, kind)
    print(json.dumps({"fields": fields_of(read), "types": kind.get_fields_and_field_types()}))


if __name__ == "__main__":
    main()
