"""The commands to a Shimmer with their opcodes, and the optional checksum of its messages.

Commands have neither framing nor checksum. Only harmless opcodes are included.
"""

from __future__ import annotations

from binascii import crc_hqx
from enum import IntEnum

TICKS_PER_S = 32768
"""Frequency of the oscillator; all rates are integer divisions of it."""
GSR_AND_PPG = 0x000104
"""Sensor mask: skin conductance and internal ADC A13."""
AUTO_RANGE = 4

# CRC-16 with polynomial 0x1021, most significant bit first, initial value 0xB0CA, no final
# inversion; a message of odd length is padded with one zero byte. From firmware sources
# (LogAndStream 0.13.7 and later).
_CRC_INITIAL = 0xB0CA


class CrcMode(IntEnum):
    """Number of checksum bytes at the end of each message from the device."""

    OFF = 0
    LOW_BYTE = 1
    FULL = 2


def crc16(message: bytes) -> int:
    """Return the checksum of a message without its checksum bytes."""
    padded = message if len(message) % 2 == 0 else message + b"\0"
    return crc_hqx(padded, _CRC_INITIAL)


def checksum(message: bytes, mode: CrcMode) -> bytes:
    """Return the checksum bytes of a message: 0, 1 or 2, the low byte first."""
    return crc16(message).to_bytes(2, "little")[:mode]


class Opcode(IntEnum):
    """First byte of a command."""

    INQUIRY = 0x01
    SET_SAMPLING_RATE = 0x05
    START_STREAMING = 0x07
    SET_SENSORS = 0x08
    STOP_STREAMING = 0x20
    SET_GSR_RANGE = 0x21
    GET_GSR_RANGE = 0x23
    GET_ALL_CALIBRATION = 0x2C
    GET_FIRMWARE = 0x2E
    GET_HARDWARE = 0x3F
    GET_BMP180_COEFFICIENTS = 0x59
    SET_EXPANSION_POWER = 0x5E
    GET_EXPANSION_POWER = 0x60
    SET_EXG_REGISTERS = 0x61
    GET_EXG_REGISTERS = 0x63
    GET_DAUGHTER_CARD = 0x66
    GET_STATUS = 0x72
    SET_CRC = 0x8B
    GET_BATTERY = 0x95
    TEST_CONNECTION = 0x96
    GET_BMP280_COEFFICIENTS = 0xA0
    SET_INSTREAM_ACK_PREFIX = 0xA3
    GET_PRESSURE_COEFFICIENTS = 0xA7


INQUIRY = bytes((Opcode.INQUIRY,))
START_STREAMING = bytes((Opcode.START_STREAMING,))
STOP_STREAMING = bytes((Opcode.STOP_STREAMING,))
GET_GSR_RANGE = bytes((Opcode.GET_GSR_RANGE,))
GET_ALL_CALIBRATION = bytes((Opcode.GET_ALL_CALIBRATION,))
GET_BMP180_COEFFICIENTS = bytes((Opcode.GET_BMP180_COEFFICIENTS,))
GET_BMP280_COEFFICIENTS = bytes((Opcode.GET_BMP280_COEFFICIENTS,))
GET_PRESSURE_COEFFICIENTS = bytes((Opcode.GET_PRESSURE_COEFFICIENTS,))
GET_FIRMWARE = bytes((Opcode.GET_FIRMWARE,))
GET_HARDWARE = bytes((Opcode.GET_HARDWARE,))
GET_EXPANSION_POWER = bytes((Opcode.GET_EXPANSION_POWER,))
GET_DAUGHTER_CARD = bytes((Opcode.GET_DAUGHTER_CARD, 3, 0))
GET_STATUS = bytes((Opcode.GET_STATUS,))
GET_BATTERY = bytes((Opcode.GET_BATTERY,))
TEST_CONNECTION = bytes((Opcode.TEST_CONNECTION,))
NO_ACK_BEFORE_STATUS = bytes((Opcode.SET_INSTREAM_ACK_PREFIX, 0))
POWER_THE_PROBE = bytes((Opcode.SET_EXPANSION_POWER, 1))


def set_sensors(mask: int) -> bytes:
    """Return the command that selects sensors by a 24-bit mask."""
    return bytes((Opcode.SET_SENSORS,)) + mask.to_bytes(3, "little")


def set_sampling_rate(divisor: int) -> bytes:
    """Return the command that sets the sample rate to 32768 Hz / ``divisor``, 1 to 65535."""
    return bytes((Opcode.SET_SAMPLING_RATE,)) + divisor.to_bytes(2, "little")


def set_gsr_range(setting: int) -> bytes:
    """Return the command that sets the feedback resistor: 0 to 3, or `AUTO_RANGE`."""
    return bytes((Opcode.SET_GSR_RANGE, setting))


def get_exg_registers(chip: int) -> bytes:
    """Return the command that reads the ten registers of an ExG chip, 0 or 1."""
    return bytes((Opcode.GET_EXG_REGISTERS, chip, 0, 10))


def set_exg_registers(chip: int, registers: bytes) -> bytes:
    """Return the command that sets the ten registers of an ExG chip, 0 or 1."""
    return bytes((Opcode.SET_EXG_REGISTERS, chip, 0, len(registers))) + registers


def set_crc(mode: CrcMode) -> bytes:
    """Return the command that enables checksums; its own answer already has one."""
    return bytes((Opcode.SET_CRC, mode))


def divisor_for(rate_hz: float) -> int:
    """Return the divisor with the rate nearest to ``rate_hz``."""
    return round(TICKS_PER_S / rate_hz)
