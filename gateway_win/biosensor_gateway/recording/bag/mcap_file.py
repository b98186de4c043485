"""Reads an MCAP file from its beginning on, in the order in which it was written.

See https://mcap.dev/spec for its records. Neither index nor footer are used, so a file of a
recorder that died is read to its last whole chunk.
"""

from __future__ import annotations

import os
import struct
from binascii import crc32
from collections.abc import Callable, Iterator, Mapping
from enum import IntEnum, unique
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from biosensor_gateway.recording.bag.errors import BagError, BagReason, MessageError
from biosensor_gateway.recording.bag.messages import Message, Note, Topic
from biosensor_gateway.recording.bag.unpacking import unpack_lz4, unpack_zstd

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
_MOST_CHUNK_BYTES = 1 << 30
_QOS = "offered_qos_profiles"


@unique
class _Op(IntEnum):
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    DATA_END = 0x0F


class _DamagedError(Exception):
    """A record makes no sense; the text is the rest of a sentence."""


class _Record(NamedTuple):
    op: int
    start: int
    content: bytes


class _Schema(NamedTuple):
    name: str
    encoding: str
    definition: str


def read_mcap(path: Path, note: Note) -> Iterator[Message]:
    """Give all messages that can be read.

    Parameters
    ----------
    note
        Is told what cannot be read.

    Raises
    ------
    BagError
        ``NOT_A_BAG`` if it is another file.
    OSError
        If it cannot be read.
    """
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            message = f"{path} is no bag: it does not begin as an MCAP file does"
            raise BagError(BagReason.NOT_A_BAG, message)
        yield from _File(path, note).read(file)


class _File:
    def __init__(self, path: Path, note: Note) -> None:
        self._path, self._note = path, note
        self._schemas: dict[int, _Schema] = {}
        self._topics: dict[int, Topic] = {}

    def read(self, file: BinaryIO) -> Iterator[Message]:
        size = file.seek(0, os.SEEK_END)
        file.seek(len(MAGIC))
        try:
            for record in _records(file, size):
                if record.op in (_Op.DATA_END, _Op.FOOTER):
                    return
                if record.op == _Op.CHUNK:
                    yield from self._chunk(record)
                else:
                    yield from self._take(record)
        except _DamagedError as error:
            self._note(f"{self._path}: {error}; what comes before was read")
            return
        self._note(f"{self._path} has no end: its recorder did not close it; the rest was read")

    def _chunk(self, record: _Record) -> Iterator[Message]:
        try:
            content = _unpacked(record.content)
            inside = list(_records(BytesIO(content), len(content)))
        except _DamagedError as error:
            self._note(f"{self._path}: the chunk at byte {record.start} cannot be read ({error})")
            return
        for each in inside:
            yield from self._take(each)

    def _take(self, record: _Record) -> Iterator[Message]:
        op, _, content = record
        try:
            if op == _Op.MESSAGE:
                channel, _, unix_ns, _ = _MESSAGE.unpack_from(content)
                topic = self._topics.get(channel)
                if topic is not None:
                    yield Message(topic, unix_ns, content[_MESSAGE.size :])
            elif op == _Op.SCHEMA:
                self._take_schema(_Fields(content))
            elif op == _Op.CHANNEL:
                self._take_channel(_Fields(content))
        except (struct.error, _DamagedError) as error:
            self._note(f"{self._path}: the record at byte {record.start} makes no sense ({error})")

    def _take_schema(self, fields: _Fields) -> None:
        number = fields.number(2)
        self._schemas[number] = _Schema(fields.text(), fields.text(), fields.text())

    def _take_channel(self, fields: _Fields) -> None:
        number, schema_number = fields.number(2), fields.number(2)
        name, encoding, metadata = fields.text(), fields.text(), fields.pairs()
        schema = self._schemas.get(schema_number)
        if encoding == "cdr" and schema is not None:
            qos = metadata.get(_QOS, "")
            topic = Topic(name, schema.name, schema.encoding, schema.definition, qos)
            # A topic is one, however often it is declared.
            self._topics[number] = topic


class _Fields:
    """The fields of a record, one after the other."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0

    def number(self, size: int) -> int:
        return int.from_bytes(self._take(size), "little")

    def text(self) -> str:
        return self._take(self.number(4)).decode("utf-8", "replace")

    def pairs(self) -> Mapping[str, str]:
        inside = _Fields(self._take(self.number(4)))
        pairs: dict[str, str] = {}
        while inside._at < len(inside._content):
            pairs[inside.text()] = inside.text()
        return pairs

    def _take(self, size: int) -> bytes:
        taken = self._content[self._at : self._at + size]
        if len(taken) < size:
            raise _DamagedError("it is too short")
        self._at += size
        return taken


def _records(file: BinaryIO, size: int) -> Iterator[_Record]:
    start = file.tell()
    while start < size:
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            raise _DamagedError(f"it is cut off at byte {start}")
        op, length = _RECORD.unpack(head)
        if start + _RECORD.size + length > size:
            raise _DamagedError(f"it is cut off or damaged at byte {start}")
        yield _Record(op, start, file.read(length))
        start += _RECORD.size + length


def _unpacked(content: bytes) -> bytes:
    if len(content) < _CHUNK.size:
        raise _DamagedError("it is too short")
    _, _, size, checksum = _CHUNK.unpack_from(content)
    fields = _Fields(content[_CHUNK.size :])
    compression = fields.text()
    packed = content[-length:] if (length := fields.number(8)) else b""
    if size > _MOST_CHUNK_BYTES:
        raise _DamagedError("it is too large to be true")
    if compression not in _UNPACKING:
        raise _DamagedError(f"it is compressed by {compression!r}, which is unknown here")
    try:
        unpacked = _UNPACKING[compression](packed, size)
    except MessageError as error:
        raise _DamagedError(str(error)) from error
    if len(unpacked) != size or (checksum and crc32(unpacked) != checksum):
        raise _DamagedError("its checksum is another")
    return unpacked


_UNPACKING: Mapping[str, Callable[[bytes, int], bytes]] = {
    "": lambda packed, _: packed,
    "lz4": unpack_lz4,
    "zstd": unpack_zstd,
}
