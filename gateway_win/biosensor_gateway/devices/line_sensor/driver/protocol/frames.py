"""Reads records of bytes that a ``struct`` format describes."""

from __future__ import annotations

import binascii
import re
import struct
from collections.abc import Callable
from math import isfinite, nan
from types import MappingProxyType

from biosensor_gateway.devices.line_sensor.driver.protocol.lines import BadLine, Flaw, Row

_SHOWN = 16
# Python's codes of numbers; `x` is a byte that means nothing.
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
"""By name: its ``struct`` code, and what computes it from the values' bytes."""


def checked_format(text: str) -> str:
    """Return a format with its byte order, ``<`` if it says none.

    Raises
    ------
    ValueError
        It is not one of numbers only.
    """
    if not _FORMAT.fullmatch(text):
        message = f"{text!r} is no format; write < or > and letters of b B h H i I q Q e f d ? x"
        raise ValueError(message)
    return text if text[0] in "<>" else f"<{text}"


def field_count(form: str) -> int:
    """Return how many values a record has."""
    return len(struct.unpack(form, bytes(struct.calcsize(form))))


def turns_over_at(form: str, position: int) -> int:
    """Return after how many counts a field begins anew; 0 if it is no unsigned integer."""
    codes = [
        code
        for count, code in re.findall(r"(\d*)([bBhHiIlLqQefd?])", form)
        for _ in range(int(count or 1))
    ]
    return 1 << _BITS[codes[position]] if codes[position] in _BITS else 0


class FrameProtocol:
    """Records of one size: a beginning, values, a checksum.

    Parameters
    ----------
    form
        The values, as :func:`checked_format` gives it.
    start
        The bytes that each record begins with; may be empty where a message holds whole records.
    checksum
        A key of `CHECKSUMS`: what follows the values, in their byte order.
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
        """Bytes of which is not said yet what they are."""
        return len(self._buffer) + len(self._dropped)

    def feed(self, data: bytes) -> list[Row | BadLine]:
        """Take bytes; return the complete records, and a finding for each run of others."""
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
        """Take a message of whole records."""
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
            why, flaw = "has another checksum than it should", Flaw.CHECKSUM
        elif self._start:
            why, flaw = f"is no record, which begins with {self._start.hex()}", Flaw.NO_FRAME
        else:
            why, flaw = f"is no whole record of {self._size} bytes", Flaw.NO_FRAME
        return [BadLine(flaw, raw[:_SHOWN], len(raw), why)]
