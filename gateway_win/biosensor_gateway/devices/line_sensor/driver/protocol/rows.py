"""The records of the protocol: rows of numbers, and lines that are none."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, unique
from typing import NamedTuple, Protocol

Row = tuple[float, ...]
"""A value for each column of the settings, NaN where the line has none."""

MAX_LINE_BYTES = 4096


@unique
class Flaw(Enum):
    """What is wrong with a line."""

    COUNT = "count"
    """Not as many values as the settings name columns."""
    NOT_A_NUMBER = "not_a_number"
    NOT_JSON = "not_json"
    NO_KEYS = "no_keys"
    """JSON without what the settings ask for."""
    TOO_LONG = "too_long"
    NOT_TEXT = "not_text"
    NO_FRAME = "no_frame"
    """Bytes where the beginning of a record should be, or a record of another length."""
    CHECKSUM = "checksum"


class Wrong(NamedTuple):
    """Why a line is none; `why` is a clause for a person that names what does not fit."""

    flaw: Flaw
    why: str


@dataclass(frozen=True, slots=True)
class BadLine:
    """What is not passed on.

    Attributes
    ----------
    flaw
    raw
        The line, or its beginning.
    size
        Its bytes on the wire.
    why
        A clause for a person that names what does not fit.
    """

    flaw: Flaw
    raw: bytes
    size: int
    why: str


class RowProtocol(Protocol):
    """Reads what a device sends, cut in any way."""

    @property
    def buffered(self) -> int:
        """Bytes that wait for the rest of their line."""
        ...

    def feed(self, data: bytes) -> list[Row | BadLine]:
        """Take bytes of a stream; return the rows that are complete. Never raises."""
        ...

    def feed_whole(self, data: bytes) -> list[Row | BadLine]:
        """Take a message that ends where its last line ends. Never raises."""
        ...
