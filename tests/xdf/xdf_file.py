"""Writes XDF files byte by byte, from the format's specification, for what no recorder writes."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

UUID = bytes.fromhex("43a546dccbf5410fb30ed5467383cbe4")
FILE_HEADER = b"<?xml version='1.0'?><info><version>1.0</version></info>"
DTYPES = {
    "float32": "<f4",
    "double64": "<f8",
    "int8": "i1",
    "int16": "<i2",
    "int32": "<i4",
    "int64": "<i8",
}


def chunk(tag: int, content: bytes, length_size: int = 4) -> bytes:
    length = (2 + len(content)).to_bytes(length_size, "little")
    return bytes([length_size]) + length + struct.pack("<H", tag) + content


def boundary() -> bytes:
    return chunk(5, UUID, 1)


def stream_header(
    stream_id: int,
    name: str,
    *,
    kind: str = "Test",
    channels: int = 1,
    rate: float = 0.0,
    fmt: str = "float32",
    source_id: str | None = None,
    host: str = "host",
    created_at: float = 100.0,
    desc: ET.Element | None = None,
) -> bytes:
    info = ET.Element("info")
    for tag, text in {
        "name": name,
        "type": kind,
        "channel_count": str(channels),
        "nominal_srate": repr(rate),
        "channel_format": fmt,
        "source_id": f"{name}-id" if source_id is None else source_id,
        "created_at": repr(created_at),
        "hostname": host,
    }.items():
        ET.SubElement(info, tag).text = text
    info.append(ET.Element("desc") if desc is None else desc)
    return chunk(2, struct.pack("<I", stream_id) + ET.tostring(info))


def samples(
    stream_id: int, fmt: str, values: Sequence[Sequence[Any]], stamps: Sequence[float | None]
) -> bytes:
    """A stamp of None is left out."""
    body = b"".join(
        (b"\0" if stamp is None else b"\x08" + struct.pack("<d", stamp)) + _values(fmt, row)
        for row, stamp in zip(values, stamps, strict=True)
    )
    count = b"\x04" + struct.pack("<I", len(stamps))
    return chunk(3, struct.pack("<I", stream_id) + count + body)


def _values(fmt: str, row: Sequence[Any]) -> bytes:
    if fmt != "string":
        return np.array(row, DTYPES[fmt]).tobytes()
    texts = [text.encode() for text in row]
    return b"".join(b"\x04" + struct.pack("<I", len(text)) + text for text in texts)


def clock_offset(stream_id: int, taken_at: float, offset: float) -> bytes:
    return chunk(4, struct.pack("<Idd", stream_id, taken_at, offset))


def footer(stream_id: int, count: int | None) -> bytes:
    told = "" if count is None else f"<sample_count>{count}</sample_count>"
    return chunk(6, struct.pack("<I", stream_id) + f"<info>{told}</info>".encode())


def xdf(*parts: bytes) -> bytes:
    return b"".join([b"XDF:", chunk(1, FILE_HEADER, 1), *parts])


def offsets(stream_id: int, times: Iterable[float], offset: float = 0.0) -> bytes:
    return b"".join(clock_offset(stream_id, time, offset) for time in times)


def regular(
    stream_id: int, name: str, stamps: Sequence[float], rate: float, **header: Any
) -> tuple[bytes, bytes, bytes]:
    """Header, samples and end of a float stream of one channel that is all right."""
    values = [[0.5 + k % 2] for k in range(len(stamps))]
    return (
        stream_header(stream_id, name, rate=rate, **header),
        samples(stream_id, "float32", values, stamps),
        offsets(stream_id, (stamps[0], stamps[-1])) + footer(stream_id, len(stamps)),
    )


def _blocks(count: int) -> list[bytes]:
    """Samples of streams 1 and 2 with a clock offset and a boundary after every tenth."""
    parts: list[bytes] = []
    for k in range(count):
        times: list[float | None] = [10 + k + n / 4 for n in range(4)]
        times[k % 4] = None if k else times[0]
        parts.append(samples(1, "float32", [[k, k]] * 4, times))
        parts.append(samples(2, "string", [[f"event {k}"]], [10.0 + k]))
        if k % 10 == 9:
            parts += [clock_offset(1, 10.0 + k, 0.001), boundary()]
    return parts


def two_streams() -> list[bytes]:
    """Return the parts of a good file with 160 numbers, some without a stamp, and 40 events."""
    return [
        b"XDF:",
        chunk(1, FILE_HEADER, 1),
        stream_header(1, "numbers", channels=2, rate=4.0, created_at=5.0),
        stream_header(2, "events", fmt="string", created_at=5.0),
        *_blocks(40),
        footer(1, 160),
        footer(2, 40),
    ]


def is_samples(part: bytes, stream_id: int) -> bool:
    return part[5:11] == struct.pack("<HI", 3, stream_id)


def chunk_ends(content: bytes) -> list[int]:
    """Return where each chunk of a good file ends."""
    ends: list[int] = []
    position = 4
    while position < len(content):
        size = content[position]
        length = int.from_bytes(content[position + 1 : position + 1 + size], "little")
        position += 1 + size + length
        ends.append(position)
    return ends
