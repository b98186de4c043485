"""Checksum of a Shimmer's messages.

CRC-16 with polynomial 0x1021, most significant bit first, initial value 0xB0CA, no
final inversion; a message of odd length is padded with one zero byte. From firmware
sources (LogAndStream 0.13.7 and later).
"""

from __future__ import annotations

from binascii import crc_hqx
from enum import IntEnum

_INITIAL = 0xB0CA


class CrcMode(IntEnum):
    """How many bytes of the checksum end each message from the device."""

    OFF = 0
    LOW_BYTE = 1
    FULL = 2


def crc16(message: bytes) -> int:
    """Return the checksum of a message, without the bytes of a checksum."""
    padded = message if len(message) % 2 == 0 else message + b"\0"
    return crc_hqx(padded, _INITIAL)


def checksum(message: bytes, mode: CrcMode) -> bytes:
    """Return the bytes that follow a message: 0, 1 or 2, the low one first."""
    return crc16(message).to_bytes(2, "little")[:mode]
