"""Encodes a Shimmer's messages and data packets, parses commands, and holds its memory.

It was written only from notes on Shimmer's public firmware and shares no code with the decoder, so
that a mistake in either shows as a difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum, unique
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

ACK, NACK, DATA, IN_STREAM = b"\xff", b"\xfe", b"\x00", b"\x8a"
TICKS_PER_S = 32768
TICKS_MODULUS = 1 << 24
_CRC_POLYNOMIAL = 0x1021
_CRC_START = 0xB0CA
REGISTERS = 10
"""Number of registers of each ExG chip."""
BMP180, BMP280 = 0, 1
_CARD_LENGTH = 2048
# Low-noise accelerometer: offset 2253, 92 counts per m/s^2, mounting; the other blocks unset.
_LN_ACCEL_ALONE = bytes.fromhex("08cd08cd08cd005c005c005c009c009c000000009c").ljust(84, b"\xff")


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


# Position of the byte with the number of following bytes.
_LENGTH_AT: Mapping[Opcode, int] = MappingProxyType(
    {Opcode.SET_NAME: 1, Opcode.SET_EXG_REGISTERS: 3}
)
_OPCODES = frozenset(int(opcode) for opcode in Opcode)


class Firmware(NamedTuple):
    """Version of LogAndStream, and its features."""

    major: int
    minor: int
    patch: int

    @property
    def has_crc(self) -> bool:
        """Whether messages can have a checksum."""
        return self >= (0, 13, 7)

    @property
    def has_prefix_switch(self) -> bool:
        """Whether the ACK before an unrequested status can be switched off."""
        return self >= (0, 15, 4)

    @property
    def has_nack(self) -> bool:
        """Whether refused commands are answered with NACK."""
        return self >= (1, 0, 0)

    @property
    def radio(self) -> str:
        """Version text of the Bluetooth module used with this firmware."""
        return "RN4678 V1.23" if self >= (0, 15, 0) else "Ver 6.15"

    def knows(self, opcode: int) -> bool:
        """Whether this byte is a known command."""
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
    """Splits a host's bytes into commands; incomplete commands cannot be detected.

    Parameters
    ----------
    firmware
        Determines the known commands; unknown bytes are ignored silently.
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
    """Return the checksum of a message: CRC-16, polynomial 0x1021, start 0xB0CA.

    A message of odd length is padded with a zero byte.
    """
    crc = _CRC_START
    for byte in message + b"\0" * (len(message) % 2):
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (_CRC_POLYNOMIAL if crc & 0x8000 else 0)
        crc &= 0xFFFF
    return crc


def sealed(message: bytes, crc_bytes: int) -> bytes:
    """Return a message with 0 to 2 bytes of its checksum, low byte first."""
    return message + crc16(message).to_bytes(2, "little")[:crc_bytes] if crc_bytes else message


def in_unknown_kind(packet: bytes) -> bytes:
    """Return bytes of the same number that do not begin any documented message."""
    return bytes(byte & 0x3F | 0x40 for byte in packet)


FULL_SCALE_V = 3.0 * 1.988
"""Full scale of the 12-bit ADC before the voltage divider."""
_FULL_SCALE_COUNTS = 4095
_LOW_COUNTS, _MIDDLE_COUNTS = 2568, 2717
# The vendor's discharge curve.
_VOLTS = (
    *(3.2, 3.627, 3.645, 3.663, 3.681, 3.699, 3.717, 3.7314, 3.735, 3.7386, 3.7566, 3.771, 3.789),
    *(3.8034, 3.8106, 3.8394, 3.861, 3.8826, 3.9078, 3.933, 3.969, 4.0086, 4.041, 4.0734, 4.113),
    4.167,
)
_PERCENT = (
    *(0.0, 5.9, 9.8, 13.8, 17.7, 21.6, 25.6, 29.5, 33.4, 37.4, 41.3, 45.2, 49.2),
    *(53.1, 57.0, 61.0, 64.9, 68.9, 72.8, 76.7, 80.7, 84.6, 88.5, 92.5, 96.4),
    100.0,
)
_UNDOCKED, _CHARGING, _FULL = 0xFF, 0x80, 0x40


def counts_at(percent: float) -> int:
    """Return the ADC counts of a battery level [percent]."""
    volts = float(np.interp(percent, _PERCENT, _VOLTS))
    return round(volts / FULL_SCALE_V * _FULL_SCALE_COUNTS)


def percent_of(counts: int) -> float:
    """Return the battery level [percent] of ADC counts."""
    return float(np.interp(counts * FULL_SCALE_V / _FULL_SCALE_COUNTS, _VOLTS, _PERCENT))


def charger_byte(counts: int, *, docked: bool) -> int:
    """Return the charger's byte: not docked, charging or full."""
    if not docked:
        return _UNDOCKED
    return _FULL if counts >= counts_at(100) else _CHARGING


def led_level(counts: int) -> int:
    """Return the colour of the battery LED: 1 low, 2 middle, 4 high."""
    if counts < _LOW_COUNTS:
        return 1
    return 2 if counts < _MIDDLE_COUNTS else 4


class _Sensor(NamedTuple):
    mask: int
    channels: tuple[int, ...]


# In the order of the firmware, which is the order in a data packet.
_SENSORS = (
    _Sensor(0x000080, (0x00, 0x01, 0x02)),  # low-noise accelerometer
    _Sensor(0x002000, (0x03,)),  # battery
    _Sensor(0x000002, (0x0D,)),  # external A7
    _Sensor(0x000001, (0x0E,)),  # external A6
    _Sensor(0x000800, (0x0F,)),  # external A15
    _Sensor(0x000200, (0x11,)),  # internal A12
    _Sensor(0x008000, (0x27, 0x28)),  # bridge amplifier
    _Sensor(0x000100, (0x12,)),  # internal A13
    _Sensor(0x800000, (0x13,)),  # internal A14
    _Sensor(0x000004, (0x1C,)),  # skin conductance
    _Sensor(0x000400, (0x10,)),  # internal A1
    _Sensor(0x000040, (0x0A, 0x0B, 0x0C)),  # gyroscope
    _Sensor(0x001000, (0x04, 0x05, 0x06)),  # wide-range accelerometer
    _Sensor(0x000020, (0x07, 0x08, 0x09)),  # magnetometer
    _Sensor(0x400000, (0x14, 0x15, 0x16)),  # alternative accelerometer
    _Sensor(0x200000, (0x17, 0x18, 0x19)),  # alternative magnetometer
    _Sensor(0x040000, (0x1A, 0x1B)),  # temperature and pressure
    _Sensor(0x000010, (0x1D, 0x1E, 0x1F)),  # ExG 1, 24 bit
    _Sensor(0x100000, (0x1D, 0x23, 0x24)),  # ExG 1, 16 bit
    _Sensor(0x000008, (0x20, 0x21, 0x22)),  # ExG 2, 24 bit
    _Sensor(0x080000, (0x20, 0x25, 0x26)),  # ExG 2, 16 bit
)
_BRIDGE, _ANALOG_13_14 = 0x008000, 0x800100
_GSR, _ANALOG_1 = 0x000004, 0x000400
_EXG_BIG_ENDIAN = frozenset({0x1E, 0x1F, *range(0x21, 0x27)})
_BIG_ENDIAN = frozenset({*range(0x0A, 0x0D), 0x1A, 0x1B}) | _EXG_BIG_ENDIAN
_WIDTHS: Mapping[int, int] = MappingProxyType(
    {0x1B: 3, 0x1D: 1, 0x1E: 3, 0x1F: 3, 0x20: 1, 0x21: 3, 0x22: 3}
)
_MAG, _OLDER_MAG = _Sensor(0x000020, (0x07, 0x08, 0x09)), _Sensor(0x000020, (0x07, 0x09, 0x08))
# Channels of the ADC come first, then those on I2C, then on SPI.
_SENSORS_OF_3R = (
    *(each for each in _SENSORS if each.channels[0] in {0x03, *range(0x0D, 0x14), 0x1C}),
    _MAG,
    _Sensor(0x000040, (0x0A, 0x0B, 0x0C)),
    _Sensor(0x000080, (0x00, 0x01, 0x02)),
    _Sensor(0x040000, (0x1B, 0x1A)),
    _Sensor(0x400000, (0x14, 0x15, 0x16)),
    _Sensor(0x001000, (0x04, 0x05, 0x06)),
    _Sensor(0x200000, (0x17, 0x18, 0x19)),
    *(each for each in _SENSORS if each.channels[0] in {0x1D, 0x20}),
)


class Model(NamedTuple):
    """Formats that differ between devices."""

    hardware: int  # 3 for a Shimmer3, 10 for a Shimmer3R.
    sensors: tuple[_Sensor, ...]  # Sensors in packet order.
    big_endian: frozenset[int]
    widths: Mapping[int, int]  # Widths in bytes of channels that do not have two.


SHIMMER3 = Model(3, _SENSORS, _BIG_ENDIAN, _WIDTHS)
"""With the newer motion sensors."""
OLDER_SHIMMER3 = SHIMMER3._replace(
    sensors=tuple(_OLDER_MAG if each == _MAG else each for each in _SENSORS),
    big_endian=_BIG_ENDIAN | {0x07, 0x08, 0x09},
)
SHIMMER3R = Model(10, _SENSORS_OF_3R, _EXG_BIG_ENDIAN, MappingProxyType({**_WIDTHS, 0x1A: 3}))


def channels_of(mask: int, model: Model = SHIMMER3) -> tuple[int, ...]:
    """Return the channel ids of a sensor mask, in packet order."""
    if mask & _BRIDGE:
        mask &= ~_ANALOG_13_14
    if mask & _GSR:  # both on one input of the converter
        mask &= ~_ANALOG_1
    return tuple(
        channel for sensor in model.sensors if mask & sensor.mask for channel in sensor.channels
    )


def data_packet(
    ticks: int, channels: Iterable[int], values: Sequence[int], model: Model = SHIMMER3
) -> bytes:
    """Return a data packet without its checksum.

    Parameters
    ----------
    ticks
        Ticks of 1/32768 s; the packet contains the low 24 bits.
    channels, values
        Channel ids as in `channels_of`, and a count for each.
    """
    body = b"".join(
        _encoded(channel, value, model) for channel, value in zip(channels, values, strict=True)
    )
    return DATA + (ticks % TICKS_MODULUS).to_bytes(3, "little") + body


def _encoded(channel: int, value: int, model: Model) -> bytes:
    width = model.widths.get(channel, 2)
    order = "big" if channel in model.big_endian else "little"
    return (value % (1 << 8 * width)).to_bytes(width, order)


@dataclass(frozen=True)
class Memory:
    """Data written in the factory."""

    model: Model = SHIMMER3
    # Number, revision and special revision of the expansion board.
    card: tuple[int, int, int] = (48, 4, 0)
    # Blocks of 21 bytes: low-noise accelerometer, gyroscope, magnetometer, wide-range
    # accelerometer; two more on a Shimmer3R.
    calibration: bytes = _LN_ACCEL_ALONE
    # pressure_chip, pressure_coefficients: 0 BMP180, 1 BMP280, 2 BMP390, 3 BMP581, and its
    # coefficients.
    pressure_chip: int = BMP280
    pressure_coefficients: bytes = b"\xff" * 24

    @property
    def page(self) -> bytes:
        """The memory of the expansion board."""
        return bytes(self.card).ljust(_CARD_LENGTH, b"\xff")


@dataclass
class Flash:
    """Settings that a Shimmer keeps without power."""

    name: str = "Shimmer_4E5F"  # Name of the unit, at most 12 ASCII characters.
    sensors: int = 0x000080  # Sensor mask of 24 bits.
    divider: int = 640  # Ticks of 1/32768 s between two samples.
    # Configuration bytes, seven on a Shimmer3R; the fourth contains the expansion power (bit 0) and
    # the range of the skin conductance (bits 1 to 3).
    setup: bytearray = field(default_factory=lambda: bytearray.fromhex("01ff0100"))
    # Ten registers of each ExG chip.
    exg: list[bytearray] = field(default_factory=lambda: [bytearray(REGISTERS) for _ in (1, 2)])

    @property
    def expansion_power(self) -> int:
        """Whether the probe is powered, 0 or 1."""
        return self.setup[3] & 1

    @expansion_power.setter
    def expansion_power(self, on: int) -> None:
        self.setup[3] = self.setup[3] & ~1 | (1 if on else 0)

    @property
    def gsr_range(self) -> int:
        """0 to 3 for a fixed resistor, 4 for auto-range."""
        return self.setup[3] >> 1 & 7

    @gsr_range.setter
    def gsr_range(self, value: int) -> None:
        self.setup[3] = self.setup[3] & ~0x0E | min(value, 4) << 1
