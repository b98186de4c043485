"""Cuts an XDF file into its chunks, and resynchronises where it is damaged.

After the magic ``XDF:`` a file is a row of chunks: one byte that tells how many
bytes the length has (1, 4 or 8), the length, a tag of two bytes, the content; all
little-endian. The length counts tag and content. See
https://github.com/sccn/xdf/wiki/Specifications.

LabRecorder writes a boundary chunk with a fixed UUID every 10 s: from there on
a damaged file can be read again.
"""

from __future__ import annotations

import os
import tempfile
import zlib
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from enum import Enum, IntEnum, unique
from pathlib import Path
from typing import BinaryIO, NamedTuple
from uuid import UUID

from biosensor_common.errors import GatewayError

MAGIC = b"XDF:"
BOUNDARY = UUID("43a546dc-cbf5-410f-b30e-d5467383cbe4").bytes
MAX_CHUNK_BYTES = 1 << 30

_GZIP_MAGIC = b"\x1f\x8b"
# The largest window, with gzip's header and checksum.
_GZIP_WINDOW = 16 + zlib.MAX_WBITS
_PACKED_BLOCK_BYTES = 4096
_LENGTH_SIZES = frozenset({1, 4, 8})
_TAG_BYTES = 2
_BLOCK_BYTES = 1 << 20


@unique
class Tag(IntEnum):
    """What a chunk holds."""

    FILE_HEADER = 1
    STREAM_HEADER = 2
    SAMPLES = 3
    CLOCK_OFFSET = 4
    BOUNDARY = 5
    STREAM_FOOTER = 6

    @property
    def title(self) -> str:
        """Its name for a person."""
        return self.name.lower().replace("_", " ")


_TAGS = frozenset(Tag)


class Chunk(NamedTuple):
    """One chunk: what it holds, and its content without the tag."""

    tag: Tag
    content: bytes


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes of the file that could not be read.

    Attributes
    ----------
    start, end
        Offsets in the file, `end` excluded.
    what
        What is wrong at `start`, as the rest of a sentence.
    breaks_off
        Nothing after `start` can be read.
    """

    start: int
    end: int
    what: str
    breaks_off: bool = False


@unique
class RecordingReason(Enum):
    """Why a recording cannot be read at all."""

    NOT_FOUND = "not_found"
    UNREADABLE = "unreadable"
    NOT_XDF = "not_xdf"


class RecordingError(GatewayError):
    """Nothing of the recording can be read."""


class ChunkError(Exception):
    """The content of a chunk makes no sense; the text is the rest of a sentence."""


class _FrameError(Exception):
    """Nothing that could be a chunk begins here."""


class _Frame(NamedTuple):
    tag: int
    content_start: int
    end: int


class OpenRecording(NamedTuple):
    """A recording that can be read.

    Attributes
    ----------
    file
        Uncompressed and seekable.
    size
        Its length in bytes.
    is_unpacked_whole
        False if it was compressed and only its beginning could be unpacked.
    """

    file: BinaryIO
    size: int
    is_unpacked_whole: bool


@contextmanager
def open_recording(path: Path) -> Generator[OpenRecording]:
    """Open a recording, compressed by gzip (``.xdfz``, ``.xdf.gz``) or not.

    Raises
    ------
    RecordingError
        If there is no such file, it cannot be read, or it is something else.
    """
    try:
        with ExitStack() as stack:
            file: BinaryIO = stack.enter_context(path.open("rb"))
            packed, is_whole = file, True
            if file.read(len(_GZIP_MAGIC)) == _GZIP_MAGIC:
                file = stack.enter_context(tempfile.TemporaryFile())
                is_whole = _unpack(packed, file)
            size = file.seek(0, os.SEEK_END)
            file.seek(0)
            if file.read(len(MAGIC)) != MAGIC:
                message = f"{path} is no XDF recording: it does not begin with 'XDF:'"
                raise RecordingError(RecordingReason.NOT_XDF, message)
            yield OpenRecording(file, size, is_whole)
    except FileNotFoundError:
        message = f"there is no file {path}"
        raise RecordingError(RecordingReason.NOT_FOUND, message) from None
    except OSError as error:
        why = "it is a folder" if path.is_dir() else error.strerror or str(error)
        message = f"cannot read {path}: {why}"
        raise RecordingError(RecordingReason.UNREADABLE, message) from error


def _unpack(packed: BinaryIO, target: BinaryIO) -> bool:
    """Unpack as far as possible; return whether that is to the end."""
    packed.seek(0)
    member = zlib.decompressobj(_GZIP_WINDOW)
    rest = b""
    # What was unpacked of a block is lost if the block is damaged, so blocks are small.
    while block := rest or packed.read(_PACKED_BLOCK_BYTES):
        if member.eof:
            member = zlib.decompressobj(_GZIP_WINDOW)
        try:
            target.write(member.decompress(block))
        except zlib.error:
            return False
        rest = member.unused_data
    return member.eof


def read_chunks(file: BinaryIO, size: int, take: Callable[[Chunk], None]) -> tuple[Damage, ...]:
    """Hand every readable chunk to `take`, in the order of the file.

    Parameters
    ----------
    file
        Seekable, with the magic at its beginning.
    size
        Length of the file in bytes; what is appended meanwhile is not read.
    take
        Raises :class:`ChunkError` for a content that makes no sense.

    Returns
    -------
    tuple of Damage
        What could not be read, in the order of the file, neighbours joined.
    """
    damages: list[Damage] = []
    position = len(MAGIC)
    while position < size:
        damage = _read_one(file, position, size, take)
        if isinstance(damage, int):
            position = damage
            continue
        if damages and damages[-1].end == damage.start:
            damage = replace(damage, start=damages[-1].start, what=damages.pop().what)
        damages.append(damage)
        position = damage.end
    return tuple(damages)


def _read_one(
    file: BinaryIO, position: int, size: int, take: Callable[[Chunk], None]
) -> Damage | int:
    """Read the chunk at `position`; return where the next one begins, or what is damaged."""
    try:
        frame = _frame(file, position, size)
    except _FrameError as error:
        return _damage(file, position, size, size, str(error))
    if frame.end > size:
        return _damage(file, position, size, size, f"{_title(frame.tag)} is cut off")
    try:
        if frame.tag not in _TAGS:
            raise ChunkError("its tag is unknown")  # noqa: TRY301 - one way out for damage
        if frame.end - position > MAX_CHUNK_BYTES:
            raise ChunkError("it is too large to be true")  # noqa: TRY301
        file.seek(frame.content_start)
        take(Chunk(Tag(frame.tag), file.read(frame.end - frame.content_start)))
    except ChunkError as error:
        return _damage(file, position, frame.end, size, f"{_title(frame.tag)}: {error}")
    return frame.end


def _title(tag: int) -> str:
    return f"a {Tag(tag).title} chunk" if tag in _TAGS else f"a chunk of kind {tag}"


def _frame(file: BinaryIO, position: int, size: int) -> _Frame:
    file.seek(position)
    head = file.read(1 + 8 + _TAG_BYTES)
    length_size = head[0]
    if length_size not in _LENGTH_SIZES:
        raise _FrameError("no chunk begins there")
    tag_start = 1 + length_size
    if len(head) < tag_start + _TAG_BYTES:
        raise _FrameError("a chunk is cut off")
    length = int.from_bytes(head[1:tag_start], "little")
    if length < _TAG_BYTES:
        raise _FrameError("a chunk of impossible length begins there")
    tag = int.from_bytes(head[tag_start : tag_start + _TAG_BYTES], "little")
    start = position + tag_start
    return _Frame(tag, start + _TAG_BYTES, start + length)


def _damage(file: BinaryIO, start: int, end: int, size: int, what: str) -> Damage:
    """Bound a damage by the next boundary within it, else by `end`."""
    boundary = _find(file, BOUNDARY, start, end)
    if boundary is not None:
        return Damage(start, boundary + len(BOUNDARY), what)
    return Damage(start, end, what, breaks_off=end == size)


def _find(file: BinaryIO, pattern: bytes, start: int, end: int) -> int | None:
    file.seek(start)
    kept = b""
    position = start
    while position < end:
        block = file.read(min(_BLOCK_BYTES, end - position))
        if not block:
            return None
        searched = kept + block
        found = searched.find(pattern)
        if found >= 0:
            return position - len(kept) + found
        position += len(block)
        kept = searched[-(len(pattern) - 1) :]
    return None
