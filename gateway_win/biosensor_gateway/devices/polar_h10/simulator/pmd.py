"""Vocabulary of Polar's measurement data (PMD) service, and its settings.

All integers are little-endian. Layouts: the Polar Measurement Data specification in
Polar's public SDK repository.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from enum import IntEnum, unique

SERVICE_UUID = "FB005C80-02E7-F387-1CAD-8ACD2D8DF0C8"
CONTROL_POINT_UUID = "FB005C81-02E7-F387-1CAD-8ACD2D8DF0C8"
DATA_UUID = "FB005C82-02E7-F387-1CAD-8ACD2D8DF0C8"

FULL_MTU = 232
"""ATT MTU that the device is made for; a larger one does not make its frames longer."""
ATT_HEADER_BYTES = 3
_FEATURES_BYTES = 17


@unique
class Measurement(IntEnum):
    """What can be measured, or switched like a measurement."""

    ECG = 0
    PPG = 1
    ACC = 2
    PPI = 3
    GYRO = 5
    MAGNETOMETER = 6
    SKIN_TEMPERATURE = 7
    SDK_MODE = 9
    LOCATION = 10
    PRESSURE = 11
    TEMPERATURE = 12
    OFFLINE_RECORDING = 13
    OFFLINE_HEART_RATE = 14


@unique
class OpCode(IntEnum):
    """First byte of a command."""

    GET_SETTINGS = 1
    START = 2
    STOP = 3
    GET_SDK_SETTINGS = 4
    GET_STATUS = 5
    GET_SDK_STATUS = 6


@unique
class Status(IntEnum):
    """How a command went."""

    SUCCESS = 0
    INVALID_OP_CODE = 1
    INVALID_MEASUREMENT_TYPE = 2
    NOT_SUPPORTED = 3
    INVALID_LENGTH = 4
    INVALID_PARAMETER = 5
    ALREADY_IN_STATE = 6
    INVALID_RESOLUTION = 7
    INVALID_SAMPLE_RATE = 8
    INVALID_RANGE = 9
    INVALID_MTU = 10
    INVALID_NUMBER_OF_CHANNELS = 11
    INVALID_STATE = 12
    DEVICE_IN_CHARGER = 13
    DISK_FULL = 14


@unique
class Setting(IntEnum):
    """Type of a setting: rate [Hz], resolution [bit], range [g or the like], channels."""

    SAMPLE_RATE = 0
    RESOLUTION = 1
    RANGE = 2
    RANGE_MILLIUNIT = 3
    CHANNELS = 4
    FACTOR = 5
    SECURITY = 6


_SIZES = {
    Setting.SAMPLE_RATE: 2,
    Setting.RESOLUTION: 2,
    Setting.RANGE: 2,
    Setting.RANGE_MILLIUNIT: 4,
    Setting.CHANNELS: 1,
    Setting.FACTOR: 4,
    Setting.SECURITY: 16,
}

Offered = Mapping[Setting, tuple[int, ...]]
"""Values that can be chosen from, by setting."""


def encode_settings(offered: Offered) -> bytes:
    """Write settings as type, count and values, in the order of the mapping."""
    return b"".join(
        bytes((setting, len(values)))
        + b"".join(value.to_bytes(_SIZES[setting], "little") for value in values)
        for setting, values in offered.items()
    )


def decode_choice(data: bytes) -> dict[Setting, int]:
    """Read the settings of a start command, of which each has exactly one value.

    Raises
    ------
    ValueError
        Of a setting that is unknown or repeated, or has not one value.
    EOFError
        If the last setting is cut short.
    """
    chosen: dict[Setting, int] = {}
    while data:
        setting = Setting(data[0])
        end = 2 + _SIZES[setting]
        if data[1:2] not in (b"", b"\1") or setting in chosen:
            raise ValueError(f"{setting.name} is repeated or has not one value")
        if len(data) < end:
            raise EOFError(f"{setting.name} is cut short")
        chosen[setting] = int.from_bytes(data[2:end], "little")
        data = data[end:]
    return chosen


def encode_factor(factor: float) -> bytes:
    """Write the setting that says how much a count is, as a start reply carries it."""
    return bytes((Setting.FACTOR, 1)) + struct.pack("<f", factor)


def encode_features(measurements: Iterable[Measurement]) -> bytes:
    """Return what reading the control point answers, 17 bytes."""
    mask = sum(1 << measurement for measurement in set(measurements))
    return (b"\x0f" + mask.to_bytes(2, "little")).ljust(_FEATURES_BYTES, b"\0")
