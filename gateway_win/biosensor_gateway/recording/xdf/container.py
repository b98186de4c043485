"""Splits an XDF file into its chunks, and finds the next chunk after damaged bytes.

A file is the magic ``XDF:`` and then a sequence of chunks, each in a frame.
LabRecorder writes a boundary chunk with a fixed UUID every 10 s. After damaged bytes, reading
continues at the next boundary or the next valid chunk, whichever comes first.
"""

from __future__ import annotations

import os
import re
import zlib
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from enum import Enum, IntEnum, unique
from pathlib import Path
from typing import BinaryIO, NamedTuple
from uuid import UUID

from biosensor_common.errors import GatewayError, cannot_write
from biosensor_gateway.system.new_file import temporary_disk, temporary_file

MAGIC = b"XDF:"
BOUNDARY = UUID("43a546dc-cbf5-410f-b30e-d5467383cbe4").bytes
STREAM_ID_BYTES = 4
_LENGTH_SIZES = frozenset({1, 4, 8})
_TAG_BYTES = 2
_LONGEST_HEAD = 1 + 8 + _TAG_BYTES
_BLOCK_BYTES = 1 << 20
_MOST_FOREIGN = 16
# The start of a frame with a known tag, for each size of the length field.
_HEAD = re.compile(
    rb"\x01(?=.[\x01-\x06]\x00)|\x04(?=.{4}[\x01-\x06]\x00)|\x08(?=.{8}[\x01-\x06]\x00)", re.DOTALL
)


@unique
class Tag(IntEnum):
    """Kind of a chunk."""

    FILE_HEADER = 1
    STREAM_HEADER = 2
    SAMPLES = 3
    CLOCK_OFFSET = 4
    BOUNDARY = 5
    STREAM_FOOTER = 6

    @property
    def title(self) -> str:
        """Its name in sentences."""
        return self.name.lower().replace("_", " ")


_TAGS = frozenset(Tag)


class FrameError(Exception):
    """No chunk begins here; the text is the reason."""


class Frame(NamedTuple):
    """The place of a chunk in the file; its tag may be unknown, and its end past the file's."""

    tag: int
    content_start: int
    end: int

    @property
    def is_known(self) -> bool:
        """Whether the format defines this kind of chunk."""
        return self.tag in _TAGS

    @property
    def title(self) -> str:
        """Its description in sentences."""
        return f"a {Tag(self.tag).title} chunk" if self.is_known else f"a chunk of kind {self.tag}"


def read_frame(file: BinaryIO, position: int) -> Frame:
    """Read the frame at `position`, which must be before the end of the file.

    Raises
    ------
    FrameError
        If there is no frame.
    """
    file.seek(position)
    head = file.read(_LONGEST_HEAD)
    if not head or (length_size := head[0]) not in _LENGTH_SIZES:
        raise FrameError("no chunk starts there")
    tag_start = 1 + length_size
    if len(head) < tag_start + _TAG_BYTES:
        raise FrameError("a chunk is cut off")
    length = int.from_bytes(head[1:tag_start], "little")
    if length < _TAG_BYTES:
        raise FrameError("a chunk of impossible length starts there")
    tag = int.from_bytes(head[tag_start : tag_start + _TAG_BYTES], "little")
    start = position + tag_start
    return Frame(tag, start + _TAG_BYTES, start + length)


def is_frame(file: BinaryIO, position: int, size: int) -> bool:
    """Whether a known kind of chunk seems to begin at `position`, or the file ends there.

    A few chunks of unknown kinds may precede it.
    """
    for _ in range(_MOST_FOREIGN):
        if position >= size:
            return position == size
        try:
            frame = read_frame(file, position)
        except FrameError:
            return False
        if frame.is_known:
            return True
        position = frame.end
    return False


def find_frames(file: BinaryIO, start: int, end: int) -> Iterator[int]:
    """Yield every offset from `start` up to but excluding `end` at which a chunk may begin."""
    position = start
    while position < end:
        file.seek(position)
        # Blocks overlap, so that a frame that begins at the end of a block is found.
        searched = file.read(min(_BLOCK_BYTES, end - position) + _LONGEST_HEAD - 1)
        last = min(_BLOCK_BYTES, end - position)
        for found in _HEAD.finditer(searched):
            if found.start() >= last:
                break
            yield position + found.start()
        position += last


def framed(tag: Tag, content: bytes) -> bytes:
    """Return a complete chunk with this content."""
    length = _TAG_BYTES + len(content)
    size = next(size for size in sorted(_LENGTH_SIZES) if length < 1 << (8 * size))
    return bytes([size]) + length.to_bytes(size, "little") + tag.to_bytes(2, "little") + content


MAX_CHUNK_BYTES = 1 << 30
_GZIP_MAGIC = b"\x1f\x8b"
# The largest window, with gzip's header and checksum.
_GZIP_WINDOW = 16 + zlib.MAX_WBITS
_PACKED_BLOCK_BYTES = 4096
# A damaged length field may span most of the file, so a larger chunk is only accepted if another
# one follows it.
_UNDOUBTED_BYTES = 1 << 24
# An undamaged file does not end with this many zeros.
_ZEROS_AT_END = 64


class Chunk(NamedTuple):
    """One chunk."""

    tag: Tag
    content: bytes
    # start, end: offsets of the whole chunk in the file, `end` excluded.
    start: int
    end: int
    damages: int  # Number of damaged places before it.
    # Whether it was found by searching after damaged bytes, so it may not be a real chunk.
    is_found: bool

    @property
    def stream_id(self) -> int:
        """Number of the stream that it belongs to; file headers and boundaries have none.

        Raises
        ------
        ChunkError
            If it is too short to have one.
        """
        if len(self.content) < STREAM_ID_BYTES:
            raise ChunkError("it is too short")
        return int.from_bytes(self.content[:STREAM_ID_BYTES], "little")

    @property
    def body(self) -> memoryview:
        """The content after the stream's number."""
        return memoryview(self.content)[STREAM_ID_BYTES:]

    def of_stream(self, number: int) -> Chunk:
        """Return a copy with this stream number."""
        if number == self.stream_id:
            return self
        return self._replace(content=number.to_bytes(STREAM_ID_BYTES, "little") + self.body)


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes of the file that could not be read."""

    # start, end: offsets in the file, `end` excluded.
    start: int
    end: int
    what: str  # What is wrong at `start`; the end of a sentence.
    breaks_off: bool = False  # Nothing after `start` can be read.
    # It is a complete chunk of a kind that the format does not define, so no known data is lost.
    is_foreign: bool = False


@unique
class RecordingReason(Enum):
    """Why a recording cannot be read at all, or cannot be salvaged."""

    NOT_FOUND = "not_found"
    UNREADABLE = "unreadable"
    NOT_XDF = "not_xdf"
    GROWS = "grows"
    """It is still being written."""
    EMPTY = "empty"
    """No sample can be read."""
    UNWRITABLE = "unwritable"
    """What is made of it, or a temporary file, cannot be written."""


class RecordingError(GatewayError):
    """The recording cannot be read, or no file can be written from it."""


class ChunkError(Exception):
    """The content of a chunk is invalid; the text is the end of a sentence."""


class _Broken(NamedTuple):
    """The reason why no chunk was read, its end if known, and whether its kind is unknown."""

    what: str
    end: int | None = None
    is_foreign: bool = False


class OpenRecording(NamedTuple):
    """A recording that can be read."""

    file: BinaryIO  # Uncompressed and seekable.
    size: int  # Its length in bytes.
    is_unpacked_whole: bool  # False if it was compressed and only its beginning could be unpacked.


_HEAD_BYTES = 64
_OTHERS = (
    (b"0       ", "it is an EDF file"),
    (b"\xffBIOSEMI", "it is a BDF file"),
    (b"<!DOCTYPE", "it is a web page that was downloaded instead of the file"),
    (b"<!doctype", "it is a web page that was downloaded instead of the file"),
    (b"<HTML", "it is a web page that was downloaded instead of the file"),
    (b"<html", "it is a web page that was downloaded instead of the file"),
    (b"version https://git-lfs", "it is a pointer of Git LFS; fetch the file with: git lfs pull"),
    (b"#ROSBAG V", "it is a bag of ROS 1; convert it with rosbags-convert, then: bag import"),
    (b"\x89MCAP0", "it is a bag of ROS 2; read it with: biosensor-gateway bag import"),
    (b"SQLite format 3", "it is a database, as bags of ROS 2 are: biosensor-gateway bag import"),
    (b"Brain Vision Data Exchange", "it is the header of a BrainVision recording"),
    (b"MATLAB 5.0", "it is a file of MATLAB"),
    (b"\x89HDF", "it is an HDF5 file"),
    (b"PK\x03\x04", "it is a ZIP archive; unpack it first"),
    (b"\x28\xb5\x2f\xfd", "it is packed with zstd; unpack it first"),
    (b"%PDF", "it is a PDF document"),
)
_TEXT = "it is a text, such as a table"
_LINE_ENDS = dict.fromkeys(map(ord, "\r\n\t"), " ")


@contextmanager
def open_recording(path: Path) -> Generator[OpenRecording]:
    """Open a recording, compressed by gzip (``.xdfz``, ``.xdf.gz``) or not.

    Raises
    ------
    RecordingError
        If the file does not exist, cannot be read or is not an XDF file.
    """
    try:
        with ExitStack() as stack:
            file: BinaryIO = stack.enter_context(path.open("rb"))
            packed, is_whole = file, True
            if file.read(len(_GZIP_MAGIC)) == _GZIP_MAGIC:
                file = stack.enter_context(temporary_file(_unwritable))
                is_whole = _unpack(packed, file)
            size = file.seek(0, os.SEEK_END)
            file.seek(0)
            head = file.read(_HEAD_BYTES)
            if not head.startswith(MAGIC):
                message = f"{path} is not an XDF recording: {_what_it_is(head)}"
                raise RecordingError(RecordingReason.NOT_XDF, message)
            yield OpenRecording(file, size, is_whole)
    except OSError as error:
        if error.filename is not None and os.fspath(error.filename) != os.fspath(path):
            # What is made of the recording cannot be written.
            message = cannot_write(str(error.filename), error)
            raise RecordingError(RecordingReason.UNWRITABLE, message) from error
        if isinstance(error, FileNotFoundError):
            message = f"there is no file {path}"
            raise RecordingError(RecordingReason.NOT_FOUND, message) from None
        why = "it is a folder" if path.is_dir() else error.strerror or str(error)
        message = f"cannot read {path}: {why}"
        raise RecordingError(RecordingReason.UNREADABLE, message) from error


def _what_it_is(head: bytes) -> str:
    """Return the kind of another file, judging by its first bytes."""
    if not head:
        return "it is empty"
    if not head.strip(b"\0"):
        return "it contains only zeros, as after a crash of the computer; try a backup"
    # A page may begin with a byte order mark and empty lines.
    bare = head.lstrip(b"\xef\xbb\xbf\r\n ")
    if bare.startswith(MAGIC):
        return "a program has saved it as text, which damages its data; use the original file"
    known = (what for begin, what in _OTHERS if bare.startswith(begin))
    is_text = bare.isascii() and bare.decode("ascii").translate(_LINE_ENDS).isprintable()
    return next(known, _TEXT if is_text else "it does not start with 'XDF:'")


def _unpack(packed: BinaryIO, target: BinaryIO) -> bool:
    """Decompress as much as possible; return whether the end was reached."""
    packed.seek(0)
    member = zlib.decompressobj(_GZIP_WINDOW)
    rest = b""
    # All data of a damaged block is lost, so blocks are small.
    while block := rest or packed.read(_PACKED_BLOCK_BYTES):
        if member.eof:
            # Some programs fill the file up with zeros.
            if not (block := block.lstrip(b"\0")):
                rest = b""
                continue
            member = zlib.decompressobj(_GZIP_WINDOW)
        try:
            unpacked = member.decompress(block)
        except zlib.error:
            break
        with temporary_disk(_unwritable):
            target.write(unpacked)
        rest = member.unused_data
    with temporary_disk(_unwritable):
        target.flush()
    return member.eof


def _unwritable(sentence: str) -> RecordingError:
    return RecordingError(RecordingReason.UNWRITABLE, sentence)


def read_chunks(file: BinaryIO, size: int, take: Callable[[Chunk], object]) -> tuple[Damage, ...]:
    """Pass every readable chunk to `take`, in the order of the file.

    Parameters
    ----------
    file
        Seekable, with the magic at its beginning.
    size
        Length of the file in bytes; anything appended while reading is ignored.
    take
        Raises :class:`ChunkError` if the content is invalid.

    Returns
    -------
    tuple of Damage
        The bytes that could not be read, in the order of the file; adjacent ranges are merged.
    """
    reader = _Reader(file, size, take)
    position = len(MAGIC)
    while position < size:
        position = reader.read_from(position)
    return tuple(reader.damages)


class _Reader:
    def __init__(self, file: BinaryIO, size: int, take: Callable[[Chunk], object]) -> None:
        self._file, self._size, self._take = file, size, take
        self.damages: list[Damage] = []

    def read_from(self, position: int) -> int:
        """Read the chunk at `position`, or else the next valid one; return where it ends."""
        read = self._read_one(position)
        if isinstance(read, int):
            return read
        start, what = position, read.what
        is_beside = bool(self.damages) and self.damages[-1].end == position
        if is_beside and not (read.is_foreign and self.damages[-1].is_foreign):
            start, what = self.damages[-1].start, self.damages.pop().what
        # Appended before the search, so that a chunk found there counts this damage.
        self.damages.append(_damage(start, self._size, self._size, what))
        begin, end = self._resume(position + 1, read.end)
        if read.is_foreign and start == position and begin == end == read.end:
            self.damages[-1] = Damage(start, end, what, is_foreign=True)
        else:
            self.damages[-1] = _damage(start, begin, self._size, self._with_zeros(what, begin))
        return end

    def _with_zeros(self, what: str, end: int) -> str:
        """Add to the description if the file ends with zeros."""
        if end < self._size:
            return what
        self._file.seek(max(0, self._size - _ZEROS_AT_END))
        has_zeros = not self._file.read(_ZEROS_AT_END).strip(b"\0")
        return (
            f"{what}; it ends with zeros, as after a crash of the computer" if has_zeros else what
        )

    def _resume(self, start: int, frame_end: int | None) -> tuple[int, int]:
        """Return where the damage ends, and where the next chunk ends, if there is one."""
        size = self._size
        if frame_end is None:
            return self._find(start, size) or (size, size)
        # An invalid chunk may have a wrong length and so cover valid chunks.
        hidden = self._find(start, frame_end)
        if hidden is None and is_frame(self._file, frame_end, size):
            return frame_end, frame_end
        return hidden or self._find(frame_end, size) or (size, size)

    def _find(self, start: int, end: int) -> tuple[int, int] | None:
        """Read the first chunk that begins between two offsets; return its start and end."""
        for place in find_frames(self._file, start, end):
            read = self._read_one(place, is_found=True)
            if isinstance(read, int):
                return place, read
        return None

    def _read_one(self, position: int, *, is_found: bool = False) -> _Broken | int:
        """Read the chunk at `position`; return its end, or the problem."""
        file = self._file
        try:
            frame = read_frame(file, position)
        except FrameError as error:
            return _Broken(str(error))
        if frame.end > self._size:
            return _Broken(f"{frame.title} is cut off")
        try:
            self._require_likely(frame, position)
            file.seek(frame.content_start)
            content = file.read(frame.end - frame.content_start)
            damages = len(self.damages)
            self._take(Chunk(Tag(frame.tag), content, position, frame.end, damages, is_found))
        except ChunkError as error:
            return _Broken(f"{frame.title}: {error}", frame.end, not frame.is_known)
        return frame.end

    def _require_likely(self, frame: Frame, position: int) -> None:
        """Reject a chunk that is unlikely to be real, before its content is read."""
        if not frame.is_known:
            raise ChunkError("its tag is unknown")
        length = frame.end - position
        is_doubtful = length > _UNDOUBTED_BYTES and not is_frame(self._file, frame.end, self._size)
        if length > MAX_CHUNK_BYTES or is_doubtful:
            raise ChunkError("its size is impossibly large")


def _damage(start: int, end: int, size: int, what: str) -> Damage:
    return Damage(start, end, what, breaks_off=end == size)
