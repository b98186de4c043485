"""Writes MCAP files byte by byte, from the format's specification, for what no recorder writes."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from tests.bags import made

MAGIC = b"\x89MCAP0\r\n"
BEGIN_NS = 1_790_000_000_000_000_000


def record(op: int, content: bytes) -> bytes:
    return struct.pack("<BQ", op, len(content)) + content


def text(value: str) -> bytes:
    content = value.encode()
    return struct.pack("<I", len(content)) + content


def schema(number: int, name: str, definition: str, encoding: str = "ros2msg") -> bytes:
    fields = text(name) + text(encoding) + text(definition)
    return record(0x03, struct.pack("<H", number) + fields)


def channel(number: int, schema_number: int, topic: str, metadata: Mapping[str, str]) -> bytes:
    pairs = b"".join(text(key) + text(value) for key, value in metadata.items())
    head = struct.pack("<HH", number, schema_number) + text(topic) + text("cdr")
    return record(0x04, head + struct.pack("<I", len(pairs)) + pairs)


def message(number: int, unix_ns: int, content: bytes) -> bytes:
    return record(0x05, struct.pack("<HIQQ", number, 0, unix_ns, unix_ns) + content)


def chunk(*records: bytes) -> bytes:
    content = b"".join(records)
    head = struct.pack("<QQQI", 0, 0, len(content), 0) + text("")
    return record(0x06, head + struct.pack("<Q", len(content)) + content)


def file(*records: bytes) -> bytes:
    return b"".join(
        [MAGIC, record(0x01, text("ros2") + text("")), *records, record(0x0F, bytes(4))]
    )


def topic(number: int, name: str, kind: str, *messages: Any, latched: bool = False) -> bytes:
    """Return all records of one topic, its messages a millisecond apart."""
    store = made.typestore()
    definition, _ = store.generate_msgdef(kind, ros_version=2)
    qos = {"offered_qos_profiles": f"- durability: {'transient_local' if latched else 'volatile'}"}
    parts = [schema(number, kind, definition), channel(number, number, name, qos)]
    parts += [
        message(
            number, 1_790_000_000_000_000_000 + at * 1_000_000, bytes(store.serialize_cdr(m, kind))
        )
        for at, m in enumerate(messages)
    ]
    return b"".join(parts)
