"""Reads the chunks of an XDF file that is being written, each byte once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from biosensor_gateway.recording.xdf.container import ChunkError
from biosensor_gateway.recording.xdf.framing import BOUNDARY, MAGIC, Tag

# LabRecorder writes what came in half a second; so much of one stream is a damaged length.
MOST_CHUNK_BYTES = 1 << 26
_BLOCK_BYTES = 1 << 20
_LENGTH_SIZES = frozenset({1, 4, 8})
_TAG_BYTES = 2
_TAGS = frozenset(Tag)
_MOST_DAMAGES = 20


class _Frame(NamedTuple):
    """Where in the buffer a chunk is; `end` may be behind it."""

    tag: int
    content: int
    end: int


class GrowingFile:
    """Hands on the chunks that came since the last time.

    A chunk that is half written waits until the rest is there; so much is kept in memory, and
    no more.

    Parameters
    ----------
    path
        The file, which need not exist yet.
    take
        Is given tag and content of each chunk; raises `ChunkError` if that makes no sense.

    Attributes
    ----------
    size
        Bytes of the file that were read.
    damages
        A sentence part for each place that could not be read, in the order of the file.
    """

    def __init__(self, path: Path, take: Callable[[Tag, memoryview], None]) -> None:
        self._path, self._take = path, take
        self._rest = b""
        self._has_begun = self._is_lost = False
        self.size = 0
        self.damages: list[str] = []

    def read_on(self) -> int:
        """Read what was appended; return how many bytes that is.

        Raises
        ------
        OSError
            If the file is there and cannot be read.
        """
        before = self.size
        try:
            with self._path.open("rb") as file:
                file.seek(self.size)
                while block := file.read(_BLOCK_BYTES):
                    self.size += len(block)
                    self._rest += block
                    self._walk()
        except FileNotFoundError:
            return 0
        return self.size - before

    def _walk(self) -> None:
        if not self._has_begun:
            if len(self._rest) < len(MAGIC):
                return
            self._has_begun = True
            if self._rest.startswith(MAGIC):
                self._rest = self._rest[len(MAGIC) :]
            else:
                self._lose(0, "it does not begin as a recording does")
        position = self._find_again(0) if self._is_lost else 0
        while (end := self._next(position)) is not None:
            position = end
        self._rest = self._rest[position:]

    def _next(self, position: int) -> int | None:
        """Take the chunk at a place of the buffer; return where to go on, None if it waits."""
        if self._is_lost or position >= len(self._rest):
            return None
        frame = _frame(self._rest, position)
        if frame is None:
            return None
        if frame.tag not in _TAGS or frame.end - position > MOST_CHUNK_BYTES:
            return self._lose(position, "no chunk begins there")
        if frame.end > len(self._rest):
            return None
        try:
            self._take(Tag(frame.tag), memoryview(self._rest)[frame.content : frame.end])
        except ChunkError as error:
            return self._lose(position, f"a {Tag(frame.tag).title} chunk: {error}")
        return frame.end

    def _lose(self, position: int, what: str) -> int:
        """Say a damage once, and look for the next place to go on from."""
        if len(self.damages) < _MOST_DAMAGES:
            self.damages.append(f"byte {self.size - len(self._rest) + position}: {what}")
        self._is_lost = True
        return self._find_again(position)

    def _find_again(self, position: int) -> int:
        found = self._rest.find(BOUNDARY, position)
        if found < 0:
            # Its beginning may be there already.
            return max(position, len(self._rest) - len(BOUNDARY) + 1)
        self._is_lost = False
        return found + len(BOUNDARY)


def _frame(buffer: bytes, position: int) -> _Frame | None:
    """Read a frame; None if more of it must come. One that cannot be has a tag that is none."""
    length_size = buffer[position]
    if length_size not in _LENGTH_SIZES:
        return _Frame(0, position, position)
    tag = position + 1 + length_size
    if tag + _TAG_BYTES > len(buffer):
        return None
    length = int.from_bytes(buffer[position + 1 : tag], "little")
    if length < _TAG_BYTES:
        return _Frame(0, position, position)
    kind = int.from_bytes(buffer[tag : tag + _TAG_BYTES], "little")
    return _Frame(kind, tag + _TAG_BYTES, tag + length)
