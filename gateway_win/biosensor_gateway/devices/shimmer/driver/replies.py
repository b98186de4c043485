"""Answers of a Shimmer: how long each is, and what it says.

Layouts from the firmware's sources (log-and-stream-common); integers are little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from biosensor_gateway.devices.shimmer.driver.messages import (
    BatteryReading,
    Calibration,
    DaughterCard,
    ExgRegisters,
    ExpansionPower,
    Firmware,
    GsrRange,
    Hardware,
    Inquiry,
    PressureChip,
    PressureCoefficients,
    Reply,
    Status,
    StatusFlag,
)

IN_STREAM = 0x8A
"""Begins what may also come between data packets."""
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
"""Of the calibration of one motion sensor."""
_MAX_EXG_BYTES = 10
_MAX_PRESSURE_BYTES = 1 + 24
_MOST_BYTES = {
    _CARD: _MAX_CARD_BYTES,
    _EXG_REGISTERS: _MAX_EXG_BYTES,
    _PRESSURE: _MAX_PRESSURE_BYTES,
}
"""Of answers that tell how long they are."""
_BATTERY_SIZE = 5
_FIRMWARE_BODY = struct.Struct("<HHBB")


@dataclass(frozen=True, slots=True)
class ReplyForm:
    """What differs between devices.

    Attributes
    ----------
    setup_bytes
        Configuration bytes of an inquiry: 7 on a Shimmer3R.
    status_bytes
        2 on a Shimmer3R from firmware 1.0.24 on.
    calibration_blocks
        Calibrated motion sensors: 6 on a Shimmer3R; 0 while nobody asks for calibrations.
    """

    setup_bytes: int = 4
    status_bytes: int = 1
    calibration_blocks: int = 4


def reply_size(buffer: Sequence[int], start: int, form: ReplyForm) -> int | None:
    """Return the size of the answer whose code is at ``start``.

    Returns
    -------
    int or None
        0 if no known answer begins there; None if more bytes must come to tell.
        The answer itself need not be complete.
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
    """Turn a whole answer, from its code on, into a record.

    Parameters
    ----------
    data
        As many bytes as `reply_size` says.
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
