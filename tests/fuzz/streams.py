"""How a stream of bytes is cut into pieces, and put together again."""

from __future__ import annotations

import random
import zlib
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from tests.fuzz.contract import ensure

T = TypeVar("T")

# Longer inputs are fed in small pieces rather than byte by byte, to stay fast.
_BYTE_BY_BYTE = 256
_SMALL = 7


def splits(data: bytes) -> Iterator[list[bytes]]:
    """Yield the bytes whole, in tiny pieces and in pieces of any size, the same each time."""
    yield [data]
    step = 1 if len(data) <= _BYTE_BY_BYTE else _SMALL
    yield [data[at : at + step] for at in range(0, len(data), step)]
    dice = random.Random(zlib.crc32(data))
    pieces: list[bytes] = []
    at = 0
    while at < len(data):
        size = dice.choice((0, 1, 2, 3, 20, 100, 500))
        pieces.append(data[at : at + size])
        at += size
    yield pieces


def same_in_any_split(data: bytes, read: Callable[[Sequence[bytes]], T]) -> T:
    """Read the bytes in different pieces; return the result, which must always be the same."""
    first, *others = (read(pieces) for pieces in splits(data))
    for other in others:
        # By their text: NaN is never equal to itself.
        ensure(repr(other) == repr(first), "the result depends on how bytes were cut", first, other)
    return first


def counted_pieces(data: bytes) -> Iterator[bytes]:
    """Cut an input into messages: two bytes of length (little-endian), then the message.

    The last one may be shorter than its length says.
    """
    at = 0
    while at + 2 <= len(data):
        size = int.from_bytes(data[at : at + 2], "little")
        yield data[at + 2 : at + 2 + size]
        at += 2 + size


def join_counted(pieces: Sequence[bytes]) -> bytes:
    """Put messages together as `counted_pieces` cuts them."""
    return b"".join(len(piece).to_bytes(2, "little") + piece for piece in pieces)
