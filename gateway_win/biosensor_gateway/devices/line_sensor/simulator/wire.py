"""Writes what a board measures as its sketch would: a line of text, or a record of bytes."""

from __future__ import annotations

import json
import struct
from typing import NamedTuple

MICROS_TURN = 1 << 32
"""Where an Arduino's ``micros()`` begins anew."""

_RECORD = struct.Struct("<IIffff")
_RECORD_START = b"\xaa\x55"
RECORD_FORMAT = "<IIffff"


class Measured(NamedTuple):
    """One look of a board at its sensors.

    Attributes
    ----------
    number
        Of the look, since it was switched on.
    micros
        Its clock.
    acc_g, gsr_us
        As they are written, in g and in microsiemens.
    """

    number: int
    micros: int
    acc_g: tuple[float, float, float]
    gsr_us: float

    @property
    def numbers(self) -> tuple[float, ...]:
        """All values, in the order of the columns."""
        return (self.number, self.micros % MICROS_TURN, *self.acc_g, self.gsr_us)


def csv_line(measured: Measured) -> bytes:
    """Write values between commas, as ``Serial.println`` ends a line."""
    number, micros, *values = measured.numbers
    return f"{number},{micros},{','.join(f'{each:.4f}' for each in values)}\r\n".encode()


def json_line(measured: Measured) -> bytes:
    """Write an object with one inside it."""
    number, micros, x, y, z, gsr = measured.numbers
    said = {"n": number, "t": micros, "acc": {"x": x, "y": y, "z": z}, "gsr": gsr}
    return json.dumps(said, separators=(",", ":")).encode() + b"\n"


def record(measured: Measured) -> bytes:
    """Write a packed C struct behind two bytes, and the CRC of its values."""
    values = _RECORD.pack(*measured.numbers)
    return _RECORD_START + values + struct.pack("<H", crc16(values))


def crc16(data: bytes) -> int:
    """Compute CRC-16 with the polynomial 0x1021, begun with 0xFFFF, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (0x1021 if crc & 0x8000 else 0)
            crc &= 0xFFFF
    return crc
