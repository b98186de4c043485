"""A Shimmer's commands with their opcodes, its messages as records, and parsing of its answers.

Layouts are from the firmware's sources (log-and-stream-common); integers are little-endian.
Commands have neither framing nor checksum. Only harmless opcodes are included.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple

TICKS_PER_S = 32768
"""Frequency of the oscillator; all rates are integer divisions of it."""
GSR_AND_PPG = 0x000104
"""Sensor mask: skin conductance and internal ADC A13."""
AUTO_RANGE = 4

# CRC-16 with polynomial 0x1021, most significant bit first, initial value 0xB0CA, no final
# inversion; a message of odd length is padded with one zero byte. From firmware sources
# (LogAndStream 0.13.7 and later).
_CRC_INITIAL = 0xB0CA


@dataclass(frozen=True, slots=True)
class Ack:
    """A command was executed; only the order shows which one."""


@dataclass(frozen=True, slots=True)
class Nack:
    """A command was refused."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One sample of every channel."""

    ticks: int  # Low 24 bits of the device's counter of 1/32768 s.
    values: tuple[int, ...]  # Raw values in the order of the inquiry.


class StatusFlag(IntFlag):
    """Bits of the status byte."""

    DOCKED = 1
    SENSING = 2
    CLOCK_SET = 4
    LOGGING = 8
    STREAMING = 16
    CARD_PRESENT = 32
    CARD_ERROR = 64
    RED_LED = 128


@dataclass(frozen=True, slots=True)
class Status:
    """State of the device, requested or not."""

    flags: StatusFlag


class Charging(IntEnum):
    """Charger state of a docked device."""

    SUSPENDED = 0xC0
    CHARGING = 0x80
    FULL = 0x40
    BAD_BATTERY = 0x00
    UNKNOWN = 0xFF
    """Not docked."""


@dataclass(frozen=True, slots=True)
class BatteryReading:
    """Battery voltage in ADC counts, and the charger's byte; see :class:`Charging`."""

    adc: int
    charger: int


@dataclass(frozen=True, slots=True)
class Hardware:
    """3 for a Shimmer3, 10 for a Shimmer3R."""

    version: int


class FirmwareKind(IntEnum):
    """Families of firmware."""

    BT_STREAM = 1
    SD_LOG = 2
    LOG_AND_STREAM = 3


@dataclass(frozen=True, slots=True)
class Firmware:
    """Family (see :class:`FirmwareKind`) and version (major, minor, patch)."""

    kind: int
    version: tuple[int, int, int]

    def __str__(self) -> str:
        names = {1: "BtStream", 2: "SDLog", 3: "LogAndStream"}
        return f"{names.get(self.kind, f'firmware {self.kind}')} {'.'.join(map(str, self.version))}"


@dataclass(frozen=True, slots=True)
class DaughterCard:
    """First bytes of the expansion board's memory: board, revision, special revision."""

    data: bytes


@dataclass(frozen=True, slots=True)
class GsrRange:
    """Setting of the feedback resistor, 4 for automatic."""

    setting: int


@dataclass(frozen=True, slots=True)
class ExpansionPower:
    """Whether the optical probe is powered."""

    on: bool


@dataclass(frozen=True, slots=True)
class ExgRegisters:
    """Registers of one of the two ExG chips, from `commands.get_exg_registers`."""

    data: bytes


@dataclass(frozen=True, slots=True)
class Calibration:
    """All calibration blocks of the motion sensors, 21 bytes each; see `calibration`."""

    data: bytes


class PressureChip(IntEnum):
    """Pressure sensors that a Shimmer may have."""

    BMP180 = 0
    BMP280 = 1
    BMP390 = 2
    BMP581 = 3


@dataclass(frozen=True, slots=True)
class PressureCoefficients:
    """Type of the pressure sensor (see `PressureChip`) and its coefficients."""

    chip: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Inquiry:
    """The setup of the device."""

    divisor: int  # The sample rate is 32768 Hz divided by it.
    setup: bytes  # Configuration bytes: 4 for a Shimmer3 and 7 for a Shimmer3R.
    channels: tuple[int, ...]  # Channel ids in the order of a data packet.

    @property
    def expansion_power(self) -> bool:
        """Whether the optical probe is powered."""
        return bool(self.setup[3] & 1)

    @property
    def pressure_oversampling(self) -> int:
        """Oversampling setting, 0 to 3; on a Shimmer3R its highest bits are stored elsewhere."""
        return self.setup[3] >> 4 & 3

    @property
    def gsr_range(self) -> int:
        """Setting of the feedback resistor, 4 for automatic."""
        return self.setup[3] >> 1 & 7


Reply = (
    Ack
    | Nack
    | Status
    | BatteryReading
    | Hardware
    | Firmware
    | DaughterCard
    | GsrRange
    | ExpansionPower
    | ExgRegisters
    | Calibration
    | PressureCoefficients
    | Inquiry
)
"""Possible answers to a command; a status may also be unrequested."""
Message = Packet | Reply


class Stamped(NamedTuple):
    """A message with the arrival of its last byte, in seconds of the LSL clock."""

    message: Message
    arrival_s: float


IN_STREAM = 0x8A
"""First byte of messages that may also come between data packets."""
MAX_CHANNELS = 48
_MAX_CARD_BYTES = 16

_INQUIRY, _STATUS, _BATTERY, _CARD = 0x02, 0x71, 0x94, 0x65
_GSR_RANGE, _HARDWARE, _FIRMWARE, _EXPANSION_POWER = 0x22, 0x25, 0x2F, 0x5F
_EXG_REGISTERS, _CALIBRATION = 0x62, 0x2D
_BMP180, _BMP280, _PRESSURE = 0x58, 0x9F, 0xA6
_FIXED_SIZES = {
    _GSR_RANGE: 2,
    _HARDWARE: 2,
    _FIRMWARE: 7,
    _EXPANSION_POWER: 2,
    _BMP180: 23,
    _BMP280: 25,
}
BLOCK_BYTES = 21
"""Size of the calibration of one motion sensor."""
_MAX_EXG_BYTES = 10
_MAX_PRESSURE_BYTES = 1 + 24
# Answers that contain their own length.
_MOST_BYTES = {
    _CARD: _MAX_CARD_BYTES,
    _EXG_REGISTERS: _MAX_EXG_BYTES,
    _PRESSURE: _MAX_PRESSURE_BYTES,
}
_BATTERY_SIZE = 5
_FIRMWARE_BODY = struct.Struct("<HHBB")


@dataclass(frozen=True, slots=True)
class ReplyForm:
    """Formats that differ between devices."""

    setup_bytes: int = 4  # Configuration bytes of an inquiry: 7 on a Shimmer3R.
    status_bytes: int = 1  # 2 on a Shimmer3R from firmware 1.0.24 on.
    # Number of calibrated motion sensors: 6 on a Shimmer3R; 0 while calibrations are not queried.
    calibration_blocks: int = 4


def reply_size(buffer: Sequence[int], start: int, form: ReplyForm) -> int | None:
    """Return the size of the answer with its code at ``start``.

    Returns
    -------
    int or None
        0 if no known answer begins there; None if more bytes are needed. The answer itself may be
        incomplete.
    """
    code = buffer[start]
    if code in _FIXED_SIZES:
        return _FIXED_SIZES[code]
    if code == IN_STREAM:
        sizes = {_STATUS: 2 + form.status_bytes, _BATTERY: _BATTERY_SIZE}
        return sizes.get(buffer[start + 1], 0) if start + 1 < len(buffer) else None
    if code == _INQUIRY:
        return _counted(buffer, start + 3 + form.setup_bytes, MAX_CHANNELS, 5 + form.setup_bytes)
    if code == _CALIBRATION:
        return 1 + form.calibration_blocks * BLOCK_BYTES if form.calibration_blocks else 0
    if code in _MOST_BYTES:
        return _counted(buffer, start + 1, _MOST_BYTES[code], 2)
    return 0


def _counted(buffer: Sequence[int], count_at: int, most: int, others: int) -> int | None:
    if count_at >= len(buffer):
        return None
    count = buffer[count_at]
    return others + count if count <= most else 0


def decode_reply(data: bytes, form: ReplyForm) -> Reply:
    """Decode a complete answer, starting at its code.

    Parameters
    ----------
    data
        As many bytes as `reply_size` returns.
    """
    if data[0] == IN_STREAM:
        return _status(data) if data[1] == _STATUS else _battery(data)
    if data[0] == _INQUIRY:
        return _inquiry(data, form)
    return _DECODERS[data[0]](data)


def _inquiry(data: bytes, form: ReplyForm) -> Inquiry:
    setup_end = 3 + form.setup_bytes
    divisor = int.from_bytes(data[1:3], "little")
    return Inquiry(divisor, data[3:setup_end], tuple(data[setup_end + 2 :]))


def _status(data: bytes) -> Status:
    return Status(StatusFlag(data[2]))


def _battery(data: bytes) -> BatteryReading:
    return BatteryReading(int.from_bytes(data[2:4], "little"), data[4])


def _firmware(data: bytes) -> Firmware:
    kind, major, minor, patch = _FIRMWARE_BODY.unpack(data[1:])
    return Firmware(kind, (major, minor, patch))


_DECODERS: dict[int, Callable[[bytes], Reply]] = {
    _GSR_RANGE: lambda data: GsrRange(data[1]),
    _HARDWARE: lambda data: Hardware(data[1]),
    _FIRMWARE: _firmware,
    _EXPANSION_POWER: lambda data: ExpansionPower(bool(data[1])),
    _CARD: lambda data: DaughterCard(data[2:]),
    _EXG_REGISTERS: lambda data: ExgRegisters(data[2:]),
    _CALIBRATION: lambda data: Calibration(data[1:]),
    _BMP180: lambda data: PressureCoefficients(PressureChip.BMP180, data[1:]),
    _BMP280: lambda data: PressureCoefficients(PressureChip.BMP280, data[1:]),
    _PRESSURE: lambda data: PressureCoefficients(data[2] if data[1] else -1, data[3:]),
}


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
