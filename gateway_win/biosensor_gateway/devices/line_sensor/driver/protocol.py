"""Parses lines of text or binary records to rows of numbers."""

from __future__ import annotations

import binascii
import json
import re
import struct
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from enum import Enum, unique
from math import isfinite, isnan, nan
from types import MappingProxyType
from typing import NamedTuple, Protocol, cast

from biosensor_gateway.devices.line_sensor import SKIPPED, Column

_SHOWN = 16
# Python's codes for numbers; `x` is a padding byte.
_FORMAT = re.compile(r"[<>]?(?:\d{0,3}[bBhHiIlLqQefd?x])+")
_BITS = MappingProxyType({"B": 8, "H": 16, "I": 32, "L": 32, "Q": 64})


def _xor(data: bytes) -> int:
    total = 0
    for each in data:
        total ^= each
    return total


CHECKSUMS: MappingProxyType[str, tuple[str, Callable[[bytes], int]]] = MappingProxyType(
    {
        "none": ("", lambda _: 0),
        "sum": ("B", lambda data: sum(data) % 256),
        "xor": ("B", _xor),
        # CRC-16/XMODEM's polynomial 0x1021 from 0xFFFF, known as CRC-16/IBM-3740.
        "crc16": ("H", lambda data: binascii.crc_hqx(data, 0xFFFF)),
    }
)
"""Checksums by name: ``struct`` code, and function of the values' bytes."""


def checked_format(text: str) -> str:
    """Return a format with its byte order, by default ``<``.

    Raises
    ------
    ValueError
        If it contains anything but numbers.
    """
    if not _FORMAT.fullmatch(text):
        message = f"{text!r} is not a format; write < or > and letters of b B h H i I q Q e f d ? x"
        raise ValueError(message)
    return text if text[0] in "<>" else f"<{text}"


def field_count(form: str) -> int:
    """Return the number of values in a record."""
    return len(struct.unpack(form, bytes(struct.calcsize(form))))


def turns_over_at(form: str, position: int) -> int:
    """Return the overflow of a field; 0 if it is not an unsigned integer."""
    codes = [
        code
        for count, code in re.findall(r"(\d*)([bBhHiIlLqQefd?])", form)
        for _ in range(int(count or 1))
    ]
    return 1 << _BITS[codes[position]] if codes[position] in _BITS else 0


class FrameProtocol:
    """Parses records of fixed size: start bytes, values, checksum.

    Parameters
    ----------
    form
        Format of the values, from :func:`checked_format`.
    start
        First bytes of each record; may be empty if messages contain complete records.
    checksum
        A key of `CHECKSUMS`: the checksum after the values, in their byte order.
    """

    def __init__(self, form: str, start: bytes = b"", checksum: str = "none") -> None:
        code, self._sum_of = CHECKSUMS[checksum]
        self._values = struct.Struct(form)
        self._sum = struct.Struct(f"{form[0]}{code}")
        self._start = start
        self._size = len(start) + self._values.size + self._sum.size
        self._buffer = bytearray()
        self._dropped = bytearray()

    @property
    def buffered(self) -> int:
        """Number of bytes not assigned yet."""
        return len(self._buffer) + len(self._dropped)

    def feed(self, data: bytes) -> list[Row | BadLine]:
        """Add bytes; return complete records, and a `BadLine` for each run of other bytes."""
        self._buffer += data
        found: list[Row | BadLine] = []
        at = 0
        while at + self._size <= len(self._buffer):
            row = self._row(bytes(self._buffer[at : at + self._size]))
            if row is None:
                self._dropped.append(self._buffer[at])
                at += 1
            else:
                found += self._bad()
                found.append(row)
                at += self._size
        del self._buffer[:at]
        if len(self._dropped) >= self._size:
            found += self._bad()
        return found

    def feed_whole(self, data: bytes) -> list[Row | BadLine]:
        """Add a message of complete records."""
        found = self.feed(data)
        self._dropped += self._buffer
        self._buffer.clear()
        return [*found, *self._bad()]

    def _row(self, frame: bytes) -> Row | None:
        if not frame.startswith(self._start):
            return None
        values = frame[len(self._start) : len(self._start) + self._values.size]
        if self._sum.size and self._sum.unpack(frame[-self._sum.size :]) != (self._sum_of(values),):
            return None
        numbers = (float(each) for each in self._values.unpack(values))
        return tuple(each if isfinite(each) else nan for each in numbers)

    def _bad(self) -> list[BadLine]:
        if not self._dropped:
            return []
        raw, self._dropped = bytes(self._dropped), bytearray()
        begins = bool(self._start) and raw.startswith(self._start)
        if begins and self._sum.size:
            why, flaw = "has a wrong checksum", Flaw.CHECKSUM
        elif self._start:
            why, flaw = f"is not a record, which starts with {self._start.hex()}", Flaw.NO_FRAME
        else:
            why, flaw = f"is not a whole record of {self._size} bytes", Flaw.NO_FRAME
        return [BadLine(flaw, raw[:_SHOWN], len(raw), why)]


COMMENT = b"#"
_SHOWN_BYTES = 60

Row = tuple[float, ...]
"""A value for each column in the settings, NaN if missing."""

MAX_LINE_BYTES = 4096
SEPARATORS = MappingProxyType({"comma": ",", "semicolon": ";", "tab": "\t", "space": " "})
"""Separators of values by their name in the settings."""

# `float` would also accept underscores and digits of any script.
_NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
# Special values as printed by boards; Arduino's Print has nan, inf and ovf.
_NO_VALUE = frozenset({"", "nan", "inf", "-inf", "+inf", "ovf"})
_SHOWN_CHARACTERS = 20
_SHOWN_KEYS = 5
_LONGEST_KEY = 20


@unique
class Flaw(Enum):
    """What is wrong with a line."""

    COUNT = "count"
    """The number of values differs from the columns in the settings."""
    NOT_A_NUMBER = "not_a_number"
    NOT_JSON = "not_json"
    NO_KEYS = "no_keys"
    """JSON without the keys in the settings."""
    TOO_LONG = "too_long"
    NOT_TEXT = "not_text"
    NO_FRAME = "no_frame"
    """Bytes other than the start of a record, or a record of wrong length."""
    CHECKSUM = "checksum"


class Wrong(NamedTuple):
    """Why a line is invalid; `why` is a clause for the user."""

    flaw: Flaw
    why: str


@dataclass(frozen=True, slots=True)
class BadLine:
    """A line that is not emitted."""

    flaw: Flaw
    raw: bytes  # The line or its start.
    size: int
    why: str  # A clause for the user about what is wrong.


class RowProtocol(Protocol):
    """Parses a device's data, received in any pieces."""

    @property
    def buffered(self) -> int:
        """Number of bytes of an incomplete line."""
        ...

    def feed(self, data: bytes) -> list[Row | BadLine]:
        """Add bytes of a stream; return the complete rows. Never raises."""
        ...

    def feed_whole(self, data: bytes) -> list[Row | BadLine]:
        """Add a message that ends with its last line. Never raises."""
        ...


ReadLine = Callable[[str], Row | Wrong | None]
"""Returns the values of a line, or what is wrong with it; None for an ignored line."""


class LineProtocol:
    """Splits lines that end with LF or CR LF; those beginning with ``#`` are comments.

    Parameters
    ----------
    read_line
        Parses a line without its line end and surrounding spaces.
    skips_first
        Whether the first line may be incomplete, as when a port is opened while the device sends.
    """

    def __init__(self, read_line: ReadLine, *, skips_first: bool = False) -> None:
        self._read_line = read_line
        self._is_skipping = skips_first
        self._buffer = bytearray()
        self._too_long = 0

    @property
    def buffered(self) -> int:
        """Number of bytes of the incomplete line."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Row | BadLine]:
        """Add bytes; return the rows of the complete lines."""
        found: list[Row | BadLine] = []
        *ended, rest = (bytes(self._buffer) + data).split(b"\n")
        for each in ended:
            said = self._line(each)
            if said is not None:
                found.append(said)
        # Only the length of an endless line is kept.
        if len(rest) > MAX_LINE_BYTES:
            self._too_long += len(rest)
            rest = b""
        self._buffer = bytearray(rest)
        return found

    def feed_whole(self, data: bytes) -> list[Row | BadLine]:
        """Add a message, whose last line may lack its line end."""
        return self.feed(data if data.endswith(b"\n") else data + b"\n")

    def _line(self, raw: bytes) -> Row | BadLine | None:
        size, self._too_long = self._too_long + len(raw) + 1, 0
        if self._is_skipping:
            self._is_skipping = False
            return None
        if size > MAX_LINE_BYTES:
            return BadLine(
                Flaw.TOO_LONG, raw[:_SHOWN_BYTES], size, f"is longer than {MAX_LINE_BYTES}"
            )
        line = raw.strip()
        if not line or line.startswith(COMMENT):
            return None
        if not line.isascii() or b"\0" in line:
            return BadLine(Flaw.NOT_TEXT, line[:_SHOWN_BYTES], size, "is no text")
        said = self._read_line(line.decode("ascii"))
        if isinstance(said, Wrong):
            return BadLine(said.flaw, line[:_SHOWN_BYTES], size, said.why)
        return said


class CsvReader:
    """Parses lines of separated values; empty values are missing.

    Parameters
    ----------
    separator
        A key of `SEPARATORS`. With any but the comma, numbers may have a decimal comma.
    needed
        Positions of the columns that each line must have a value in.
    """

    def __init__(self, labels: Sequence[str], separator: str, needed: Collection[int] = ()) -> None:
        self._needed = frozenset(needed)
        self._labels = tuple(labels)
        self._separator = separator

    def __call__(self, line: str) -> Row | Wrong | None:
        """Parse a line; a heading with the columns' labels is ignored."""
        values = _split(line, self._separator)
        if len(values) != len(self._labels):
            return Wrong(Flaw.COUNT, self._miscounted(line, len(values)))
        row: list[float] = []
        for position, label in enumerate(self._labels):
            value = _without_label(values[position], label)
            number = 0.0 if label == SKIPPED else self._number(value)
            if number is None or (position in self._needed and isnan(number)):
                if tuple(values) == self._labels:
                    return None
                shown = value[:_SHOWN_CHARACTERS]
                return Wrong(
                    Flaw.NOT_A_NUMBER, f"has {shown!r} in column {label}, which is not a number"
                )
            row.append(number)
        return tuple(row)

    def _number(self, value: str) -> float | None:
        if self._separator != "comma":
            value = value.replace(",", ".")
        if _NUMBER.fullmatch(value):
            number = float(value)
            return number if abs(number) < float("inf") else nan
        return nan if value.lower() in _NO_VALUE else None

    def _miscounted(self, line: str, count: int) -> str:
        wanted = len(self._labels)
        said = f"has {_values(count)} between {self._separator}s, but columns names {wanted}"
        others = [each for each in SEPARATORS if len(_split(line, each)) == wanted]
        if line.startswith(("{", "[")):
            return f'{said}; it looks like format = "json"'
        if others:
            return f'{said}; it has as many with separator = "{others[0]}"'
        return said


def _split(line: str, separator: str) -> list[str]:
    if separator == "space":
        return line.split()
    return [each.strip() for each in line.split(SEPARATORS[separator])]


def _without_label(value: str, label: str) -> str:
    """Return the value after a label, as in Arduino's plotter format: ``gsr:512``."""
    told, colon, number = value.partition(":")
    return number.strip() if colon and label in (told.strip(), SKIPPED) else value


def _values(count: int) -> str:
    return "1 value" if count == 1 else f"{count} values"


class JsonReader:
    """Parses JSON objects by their keys, and arrays by the order of the columns.

    A column's value has its label as key, either at the top level or in an object with its
    stream's name as key. Missing and null values become NaN.

    Parameters
    ----------
    columns
        Columns in the settings.
    needed
        Positions of the columns that each line must have.
    """

    def __init__(self, columns: Sequence[Column], needed: Collection[int] = ()) -> None:
        self._columns = tuple(columns)
        self._needed = frozenset(needed)

    def __call__(self, line: str) -> Row | Wrong | None:
        """Parse a line."""
        try:
            said: object = json.loads(line)
        except (ValueError, RecursionError):
            hint = "" if line.startswith(("{", "[")) else '; is it format = "csv"?'
            return Wrong(Flaw.NOT_JSON, f"is no JSON{hint}")
        if isinstance(said, dict):
            return self._of_object(cast("dict[str, object]", said))
        if isinstance(said, list):
            return self._of_array(cast("list[object]", said))
        return Wrong(Flaw.NOT_JSON, "is neither a JSON object nor an array")

    def _of_object(self, said: dict[str, object]) -> Row | Wrong:
        values = [_looked_up(said, each) for each in self._columns]
        missing = [
            each.label
            for position, (each, value) in enumerate(zip(self._columns, values, strict=True))
            if value is None and (position in self._needed)
        ]
        if missing or all(value is None for value in values):
            wanted = missing or [each.label for each in self._columns if not each.is_skipped]
            has = (
                ", ".join(ascii(each[:_LONGEST_KEY]) for each in list(said)[:_SHOWN_KEYS]) or "none"
            )
            names = ", ".join(wanted[:_SHOWN_KEYS])
            return Wrong(Flaw.NO_KEYS, f"has no key {names}; its keys are {has}")
        return self._row(values)

    def _of_array(self, said: list[object]) -> Row | Wrong:
        if len(said) != len(self._columns):
            wanted = len(self._columns)
            return Wrong(Flaw.COUNT, f"has {len(said)} values, but columns names {wanted}")
        return self._row(said)

    def _row(self, values: Sequence[object]) -> Row | Wrong:
        row: list[float] = []
        for each, value in zip(self._columns, values, strict=True):
            number = nan if each.is_skipped else _number(value)
            if number is None:
                return Wrong(Flaw.NOT_A_NUMBER, f"has no number in {each.label}")
            row.append(number)
        return tuple(row)


def _looked_up(said: dict[str, object], each: Column) -> object:
    inner = said.get(each.stream)
    if isinstance(inner, dict) and each.label in inner:
        return cast("dict[str, object]", inner)[each.label]
    return said.get(each.label)


def _number(value: object) -> float | None:
    if value is None:
        return nan
    if not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return nan
    return number if isfinite(number) else nan
