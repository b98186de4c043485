"""Reads and writes the frames of chunks, and finds possible starts of chunks.

A frame consists of the size of the length field in bytes (one byte: 1, 4 or 8), the length, and a
tag of two bytes; the content follows. All numbers are little-endian, and the length includes tag
and content. See https://github.com/sccn/xdf/wiki/Specifications.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import IntEnum, unique
from typing import BinaryIO, NamedTuple
from uuid import UUID

MAGIC = b"XDF:"
BOUNDARY = UUID("43a546dc-cbf5-410f-b30e-d5467383cbe4").bytes
STREAM_ID_BYTES = 4

_LENGTH_SIZES = frozenset({1, 4, 8})
_TAG_BYTES = 2
_LONGEST_HEAD = 1 + 8 + _TAG_BYTES
_BLOCK_BYTES = 1 << 20
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
    """No chunk begins here; the text says why."""


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
        raise FrameError("no chunk begins there")
    tag_start = 1 + length_size
    if len(head) < tag_start + _TAG_BYTES:
        raise FrameError("a chunk is cut off")
    length = int.from_bytes(head[1:tag_start], "little")
    if length < _TAG_BYTES:
        raise FrameError("a chunk of impossible length begins there")
    tag = int.from_bytes(head[tag_start : tag_start + _TAG_BYTES], "little")
    start = position + tag_start
    return Frame(tag, start + _TAG_BYTES, start + length)


def is_frame(file: BinaryIO, position: int, size: int) -> bool:
    """Whether a known kind of chunk seems to begin at `position`, or the file ends there."""
    if position >= size:
        return position == size
    try:
        return read_frame(file, position).is_known
    except FrameError:
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
