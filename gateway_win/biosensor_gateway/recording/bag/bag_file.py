"""Opens a bag: a folder written by ``ros2 bag record``, or one of its files.

Reads MCAP and SQLite, compressed or not. An MCAP file is read sequentially from its start; its
records are specified at https://mcap.dev/spec. The index and the footer are not used, so the file
of a crashed recorder can be read up to its last complete chunk.
"""

from __future__ import annotations

import os
import re
import sqlite3
import struct
from binascii import crc32
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from enum import IntEnum, unique
from importlib import import_module
from io import BytesIO, RawIOBase
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, NamedTuple

from biosensor_gateway.recording.bag.types import (
    BagError,
    BagReason,
    Message,
    MessageError,
    Note,
    Topic,
)
from biosensor_gateway.system.new_file import temporary_disk

_BLOCK_BYTES = 1 << 20
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def unpack_zstd(packed: bytes, most: int) -> bytes:
    """Decompress a zstd frame, up to `most` bytes.

    Raises
    ------
    MessageError
        If it is invalid.
    """
    zstd = _zstd()
    try:
        return zstd.ZstdDecompressor().decompress(packed, max_length=most)
    except (zstd.ZstdError, EOFError, ValueError) as error:
        raise MessageError("it cannot be unpacked") from error


def unpack_zstd_file(packed: Path, target: Path) -> None:
    """Decompress a zstd file into another file, block by block.

    Raises
    ------
    MessageError
        If it is invalid or damaged; the data before the damage is written.
    BagError
        ``UNWRITABLE``, if there is no room for it.
    OSError
        If it cannot be read.
    """
    zstd = _zstd()
    with temporary_disk(_unwritable):
        unpacked = target.open("wb", buffering=0)
    with unpacked:
        try:
            with zstd.open(packed, "rb") as file:
                while block := file.read(_BLOCK_BYTES):
                    _write_all(unpacked, block)
        except (zstd.ZstdError, EOFError) as error:
            raise MessageError("not all of it can be unpacked") from error


def _write_all(file: RawIOBase, block: bytes) -> None:
    left = memoryview(block)
    with temporary_disk(_unwritable):
        while left:
            # On a disk that is nearly full, only a part of it.
            left = left[file.write(left) or 0 :]


def _unwritable(sentence: str) -> BagError:
    return BagError(BagReason.UNWRITABLE, sentence)


def unpack_lz4(packed: bytes, most: int) -> bytes:
    """Decompress an lz4 frame, up to `most` bytes.

    Raises
    ------
    MessageError
        If it is invalid.
    """
    lz4: Any = import_module("lz4.frame")
    try:
        return lz4.LZ4FrameDecompressor().decompress(packed, max_length=most)
    except (RuntimeError, EOFError, ValueError) as error:
        raise MessageError("it cannot be unpacked") from error


def _zstd() -> Any:
    try:
        return import_module("compression.zstd")
    except ImportError:
        # For Python before 3.14.
        return import_module("backports.zstd")


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
    """A record is invalid; the text is the end of a sentence."""


class _Record(NamedTuple):
    op: int
    start: int
    content: bytes


class _Schema(NamedTuple):
    name: str
    encoding: str
    definition: str


def read_mcap(path: Path, note: Note) -> Iterator[Message]:
    """Yield all readable messages.

    Parameters
    ----------
    note
        Called with a sentence about anything that cannot be read.

    Raises
    ------
    BagError
        ``NOT_A_BAG`` if it is another file.
    OSError
        If it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(len(MAGIC))
        if head != MAGIC:
            why = "it does not begin like an MCAP file" if head else "it is empty"
            message = f"{path} is not a bag: {why}"
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
        self._note(
            f"{self._path} has no end: its recorder did not close it; everything before was read"
        )

    def _chunk(self, record: _Record) -> Iterator[Message]:
        try:
            content = _unpacked_chunk(record.content)
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
            self._note(f"{self._path}: the record at byte {record.start} is invalid ({error})")

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
            # A topic that is declared more than once stays the same object.
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


def _unpacked_chunk(content: bytes) -> bytes:
    if len(content) < _CHUNK.size:
        raise _DamagedError("it is too short")
    _, _, size, checksum = _CHUNK.unpack_from(content)
    fields = _Fields(content[_CHUNK.size :])
    compression = fields.text()
    packed = content[-length:] if (length := fields.number(8)) else b""
    if size > _MOST_CHUNK_BYTES:
        raise _DamagedError("its size is impossibly large")
    if compression not in _UNPACKING:
        raise _DamagedError(f"it is compressed with {compression!r}, which is not supported")
    try:
        unpacked = _UNPACKING[compression](packed, size)
    except MessageError as error:
        raise _DamagedError(str(error)) from error
    if len(unpacked) != size or (checksum and crc32(unpacked) != checksum):
        raise _DamagedError("its checksum is wrong")
    return unpacked


_UNPACKING: Mapping[str, Callable[[bytes, int], bytes]] = {
    "": lambda packed, _: packed,
    "lz4": unpack_lz4,
    "zstd": unpack_zstd,
}


# Damage can also raise these errors of libraries.
_UNREADABLE = (sqlite3.Error, UnicodeDecodeError, OverflowError)


def _text(content: bytes) -> str:
    return content.decode("utf-8", "replace")


def read_sqlite(path: Path, note: Note) -> Iterator[Message]:
    """Yield all readable messages, in the order of recording.

    Parameters
    ----------
    note
        Called with a sentence about anything that cannot be read.

    Raises
    ------
    BagError
        ``NOT_A_BAG`` if it is another file.
    """
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        database.text_factory = _text
        try:
            topics = _topics(database)
        except _UNREADABLE as error:
            message = f"{path} is not a bag: {error}"
            raise BagError(BagReason.NOT_A_BAG, message) from error
        try:
            rows = database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id")
            for number, unix_ns, content in rows:
                topic = topics.get(number)
                if topic and isinstance(content, bytes) and isinstance(unix_ns, int):
                    yield Message(topic, unix_ns, content)
        except _UNREADABLE as error:
            note(f"{path} is damaged ({error}); what comes before was read")


def _topics(database: sqlite3.Connection) -> dict[int, Topic]:
    definitions = _definitions(database)
    rows = database.execute(
        "SELECT id, name, type, offered_qos_profiles FROM topics WHERE serialization_format = 'cdr'"
    )
    topics: dict[int, Topic] = {}
    for number, name, type_name, qos in rows:
        encoding, text = definitions.get(type_name, ("", ""))
        topics[number] = Topic(str(name), str(type_name), encoding, text, str(qos or ""))
    return topics


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    """Return encoding and text of definitions by type; bags before ROS 2 Iron have none."""
    try:
        rows = database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        return {str(name): (str(encoding), str(text)) for name, encoding, text in rows}
    except _UNREADABLE:
        return {}


_READERS: Mapping[str, Callable[[Path, Note], Iterator[Message]]] = {
    ".mcap": read_mcap,
    ".db3": read_sqlite,
}
_PACKED = ".zstd"
_MOST_MESSAGE_BYTES = 1 << 28


def bag_files(path: Path) -> list[Path]:
    """Return the files of a bag, in order.

    The metadata file is not needed, because a crashed recorder does not write one.

    Raises
    ------
    BagError
        If it is not a bag.
    """
    if not path.exists():
        raise BagError(BagReason.NOT_FOUND, f"there is no file or folder {path}")
    if not path.is_dir():
        if _unpacked_path(path).suffix not in _READERS:
            message = (
                f"{path} is not a bag: a bag is a folder, or a file that ends in .mcap or .db3"
            )
            raise BagError(BagReason.NOT_A_BAG, message)
        return [path]
    # A recorder that crashed while compressing a file leaves both; the uncompressed one is used.
    found = {_unpacked_path(each): each for each in sorted(path.iterdir(), reverse=True)}
    files = [each for plain, each in found.items() if plain.suffix in _READERS]
    if not files:
        raise BagError(BagReason.NOT_A_BAG, f"{path} is a folder without a bag file")
    return sorted(files, key=lambda each: _place(_unpacked_path(each)))


def read_bag(path: Path, note: Note) -> Iterator[Message]:
    """Yield all readable messages of a bag, in the order of writing.

    Parameters
    ----------
    note
        Called with a sentence about anything that cannot be read.

    Raises
    ------
    BagError
        If nothing can be read.
    """
    for file in bag_files(path):
        try:
            with _plain(file, note) as plain:
                for message in _READERS[plain.suffix](plain, note):
                    if message.content.startswith(ZSTD_MAGIC):
                        yield from _unpacked(message, note)
                    else:
                        yield message
        except BagError as error:
            if file.suffix != _PACKED:
                raise
            if error.reason is BagReason.UNWRITABLE:
                raise
            # The error names the temporary decompressed file, so it is replaced by the file's
            # name.
            note(f"{file.name}: it cannot be read ({error.reason.name.lower()})")
        except OSError as error:
            text = f"cannot read {file}: {error.strerror or error}"
            raise BagError(BagReason.UNREADABLE, text) from error


def _unpacked_path(path: Path) -> Path:
    return path.with_suffix("") if path.suffix == _PACKED else path


@contextmanager
def _plain(file: Path, note: Note) -> Generator[Path]:
    """Yield the file, or a decompressed copy of it, up to the first damage."""
    if file.suffix != _PACKED:
        yield file
        return
    with ExitStack() as stack:
        with temporary_disk(_unwritable):
            folder = stack.enter_context(TemporaryDirectory(prefix="biosensor-gateway-bag-"))
        plain = Path(folder, _unpacked_path(file).name)
        try:
            unpack_zstd_file(file, plain)
        except MessageError as error:
            note(f"{file.name}: {error}")
        yield plain


def _unpacked(message: Message, note: Note) -> Iterator[Message]:
    """Yield the decompressed message of a bag with compressed messages."""
    try:
        yield message._replace(content=unpack_zstd(message.content, _MOST_MESSAGE_BYTES))
    except MessageError as error:
        note(f"{message.topic.name}: a message is left out ({error})")


def _place(path: Path) -> tuple[list[int], str]:
    """Order ``bag_2`` before ``bag_10``."""
    return [int(number) for number in re.findall(r"\d+", path.stem)[-1:]], path.name
