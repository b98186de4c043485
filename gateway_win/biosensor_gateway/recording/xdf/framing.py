"""Reads and writes the frames of chunks, and finds where one may begin.

A frame is one byte that tells how many bytes the length has (1, 4 or 8), the length, and a
tag of two bytes; then comes the content. All is little-endian, and the length counts tag
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
# The beginning of a frame with one of the known tags, for each size of the length.
_HEAD = re.compile(
    rb"\x01(?=.[\x01-\x06]\x00)|\x04(?=.{4}[\x01-\x06]\x00)|\x08(?=.{8}[\x01-\x06]\x00)", re.DOTALL
)


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


class FrameError(Exception):
    """Nothing that could be a chunk begins here; the text says what does."""


class Frame(NamedTuple):
    """Where in the file a chunk is; its tag may be unknown, and its end behind the file's."""

    tag: int
    content_start: int
    end: int

    @property
    def is_known(self) -> bool:
        """Whether there are chunks of this kind."""
        return self.tag in _TAGS

    @property
    def title(self) -> str:
        """What it is, for a person."""
        return f"a {Tag(self.tag).title} chunk" if self.is_known else f"a chunk of kind {self.tag}"


def read_frame(file: BinaryIO, position: int) -> Frame:
    """Read the frame at `position`, which is before the file's end.

    Raises
    ------
    FrameError
        If there is none.
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
    """Whether a chunk of a known kind seems to begin at `position`, or the file ends there."""
    if position >= size:
        return position == size
    try:
        return read_frame(file, position).is_known
    except FrameError:
        return False


def find_frames(file: BinaryIO, start: int, end: int) -> Iterator[int]:
    """Give every place from `start` to before `end` at which a chunk may begin."""
    position = start
    while position < end:
        file.seek(position)
        # The head of a frame that begins with the block's last byte is searched, too.
        searched = file.read(min(_BLOCK_BYTES, end - position) + _LONGEST_HEAD - 1)
        last = min(_BLOCK_BYTES, end - position)
        for found in _HEAD.finditer(searched):
            if found.start() >= last:
                break
            yield position + found.start()
        position += last


def framed(tag: Tag, content: bytes) -> bytes:
    """Return a chunk."""
    length = _TAG_BYTES + len(content)
    size = next(size for size in sorted(_LENGTH_SIZES) if length < 1 << (8 * size))
    return bytes([size]) + length.to_bytes(size, "little") + tag.to_bytes(2, "little") + content
