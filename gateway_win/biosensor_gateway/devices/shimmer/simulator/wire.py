"""Encodes what a Shimmer3 sends, and cuts a host's bytes into commands.

Written from the notes on Shimmer's public firmware alone and shared with no decoder,
so that a mistake in one of them shows as a disagreement.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, unique
from types import MappingProxyType
from typing import NamedTuple

ACK, NACK, DATA, IN_STREAM = b"\xff", b"\xfe", b"\x00", b"\x8a"
TICKS_PER_S = 32768
TICKS_MODULUS = 1 << 24
_CRC_POLYNOMIAL = 0x1021
_CRC_START = 0xB0CA


@unique
class Opcode(IntEnum):
    """Commands of the host."""

    INQUIRY = 0x01
    GET_SAMPLING_RATE = 0x03
    SET_SAMPLING_RATE = 0x05
    TOGGLE_LED = 0x06
    START_STREAMING = 0x07
    SET_SENSORS = 0x08
    SET_SETUP_BYTES = 0x0E
    GET_SETUP_BYTES = 0x10
    STOP_STREAMING = 0x20
    SET_GSR_RANGE = 0x21
    GET_GSR_RANGE = 0x23
    GET_SHIMMER_VERSION_OLD = 0x24
    GET_ALL_CALIBRATION = 0x2C
    GET_BMP180_COEFFICIENTS = 0x59
    GET_FIRMWARE_VERSION = 0x2E
    GET_CHARGE_LED = 0x32
    GET_SHIMMER_VERSION = 0x3F
    SET_EXPANSION_POWER = 0x5E
    GET_EXPANSION_POWER = 0x60
    SET_EXG_REGISTERS = 0x61
    GET_EXG_REGISTERS = 0x63
    GET_DAUGHTER_CARD = 0x66
    GET_STATUS = 0x72
    SET_NAME = 0x79
    GET_NAME = 0x7B
    SET_CRC = 0x8B
    SET_CLOCK = 0x8F
    GET_CLOCK = 0x91
    GET_BATTERY = 0x95
    TEST_CONNECTION = 0x96
    GET_BMP280_COEFFICIENTS = 0xA0
    GET_RADIO_VERSION = 0xA1
    SET_ACK_PREFIX = 0xA3
    GET_PRESSURE_COEFFICIENTS = 0xA7


_ARGUMENTS: Mapping[Opcode, int] = MappingProxyType(
    {
        Opcode.SET_SAMPLING_RATE: 2,
        Opcode.SET_SENSORS: 3,
        Opcode.SET_SETUP_BYTES: 4,
        Opcode.SET_GSR_RANGE: 1,
        Opcode.SET_EXPANSION_POWER: 1,
        Opcode.GET_EXG_REGISTERS: 3,
        Opcode.GET_DAUGHTER_CARD: 2,
        Opcode.SET_CRC: 1,
        Opcode.SET_CLOCK: 8,
        Opcode.SET_ACK_PREFIX: 1,
    }
)


_LENGTH_AT: Mapping[Opcode, int] = MappingProxyType(
    {Opcode.SET_NAME: 1, Opcode.SET_EXG_REGISTERS: 3}
)
"""Place of the byte that tells how many follow it."""
_OPCODES = frozenset(int(opcode) for opcode in Opcode)


class Firmware(NamedTuple):
    """Version of LogAndStream, and what it can."""

    major: int
    minor: int
    patch: int

    @property
    def has_crc(self) -> bool:
        """Whether messages can carry a check."""
        return self >= (0, 13, 7)

    @property
    def has_prefix_switch(self) -> bool:
        """Whether the ACK before a pushed status can be switched off."""
        return self >= (0, 15, 4)

    @property
    def has_nack(self) -> bool:
        """Whether a command is refused aloud."""
        return self >= (1, 0, 0)

    @property
    def radio(self) -> str:
        """What the Bluetooth module of its time says of itself."""
        return "RN4678 V1.23" if self >= (0, 15, 0) else "Ver 6.15"

    def knows(self, opcode: int) -> bool:
        """Tell whether it takes this byte for a command."""
        if opcode == Opcode.SET_CRC:
            return self.has_crc
        if opcode == Opcode.SET_ACK_PREFIX:
            return self.has_prefix_switch
        if opcode == Opcode.GET_PRESSURE_COEFFICIENTS:
            return self >= (0, 16, 6)
        return opcode in _OPCODES


class Command(NamedTuple):
    """A command with all of its arguments."""

    opcode: Opcode
    arguments: bytes


class CommandReader:
    """Collects a host's bytes into commands; has no way to tell that one is torn.

    Parameters
    ----------
    firmware
        A byte that it does not know as a command is passed over without a word.
    """

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._collected = bytearray()

    def feed(self, data: bytes) -> list[Command]:
        """Return the commands that ``data`` completes."""
        commands: list[Command] = []
        for byte in data:
            if not self._collected and not self._firmware.knows(byte):
                continue
            self._collected.append(byte)
            if len(self._collected) >= self._size():
                commands.append(Command(Opcode(self._collected[0]), bytes(self._collected[1:])))
                self._collected.clear()
        return commands

    def _size(self) -> int:
        opcode = Opcode(self._collected[0])
        if opcode in _LENGTH_AT:
            at = _LENGTH_AT[opcode]
            return at + 1 + (self._collected[at] if len(self._collected) > at else 0)
        return 1 + _ARGUMENTS.get(opcode, 0)


def crc16(message: bytes) -> int:
    """Return the check of a message: CRC-16, polynomial 0x1021, start 0xB0CA.

    A message of odd length is padded with a zero byte for it.
    """
    crc = _CRC_START
    for byte in message + b"\0" * (len(message) % 2):
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (_CRC_POLYNOMIAL if crc & 0x8000 else 0)
        crc &= 0xFFFF
    return crc


def sealed(message: bytes, crc_bytes: int) -> bytes:
    """Return a message with so many bytes of its check, 0 to 2, low byte first."""
    return message + crc16(message).to_bytes(2, "little")[:crc_bytes] if crc_bytes else message


def in_unknown_kind(packet: bytes) -> bytes:
    """Return so many bytes of which none begins a message that any document has."""
    return bytes(byte & 0x3F | 0x40 for byte in packet)
