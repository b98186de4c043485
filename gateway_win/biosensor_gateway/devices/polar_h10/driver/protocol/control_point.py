"""Commands to the control point, and its answers."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import isfinite

CONTROL_POINT = "fb005c81-02e7-f387-1cad-8acd2d8df0c8"

_FEATURES = 0x0F
_REPLY = 0xF0
_STOPPED = 0x01


class Measurement(IntEnum):
    """Known measurements of devices; other numbers exist."""

    ECG = 0
    PPG = 1
    ACCELERATION = 2
    PULSE_INTERVALS = 3
    GYROSCOPE = 5
    MAGNETOMETER = 6
    SDK_MODE = 9
    """Not a measurement, but started and stopped like one."""


class Operation(IntEnum):
    """First byte of a command."""

    GET_SETTINGS = 1
    START = 2
    STOP = 3


class Status(IntEnum):
    """Result of a command; higher numbers may occur."""

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


class Setting(IntEnum):
    """Settings of a measurement: rate [Hz], resolution [bit], range [g for acceleration]."""

    SAMPLE_RATE = 0
    RESOLUTION = 1
    RANGE = 2
    RANGE_MILLIUNIT = 3
    CHANNELS = 4
    FACTOR = 5
    SECURITY = 6


# Settings that a start command contains.
_FORMATS: dict[int, str] = {
    Setting.SAMPLE_RATE: "H",
    Setting.RESOLUTION: "H",
    Setting.RANGE: "H",
    Setting.RANGE_MILLIUNIT: "I",
    Setting.CHANNELS: "B",
}
_FACTOR_FORMAT = struct.Struct("<f")
_SIZES = {
    **{setting: struct.calcsize(f"<{code}") for setting, code in _FORMATS.items()},
    Setting.FACTOR: _FACTOR_FORMAT.size,
    Setting.SECURITY: 16,
}


@dataclass(frozen=True, slots=True)
class Reply:
    """One packet of a reply."""

    # operation, measurement: operation and measurement of the command.
    operation: int
    measurement: int
    status: int  # One of `Status`, or an unknown code.
    more: bool = False  # Whether further packets follow, whose parameters continue these.
    parameters: bytes = b""

    @property
    def status_text(self) -> str:
        """Name of the status for messages."""
        known = self.status in set(Status)
        return Status(self.status).name if known else f"unknown error {self.status}"


@dataclass(frozen=True, slots=True)
class Stopped:
    """A notice that the device stopped measurements by itself."""

    measurements: tuple[int, ...]


def has_features(data: bytes) -> bool:
    """Whether the control point's value lists the available measurements."""
    return len(data) >= 3 and data[0] == _FEATURES


def parse_features(data: bytes) -> frozenset[int]:
    """Parse the available measurements from the control point's value."""
    if not has_features(data):
        return frozenset()
    mask = int.from_bytes(data[1:3], "little")
    return frozenset(bit for bit in range(16) if mask >> bit & 1)


def parse_indication(data: bytes) -> Reply | Stopped | None:
    """Parse an indication of the control point; None for anything else.

    When the features are read, BlueZ also passes them on as an indication.
    """
    if data[:1] == bytes([_STOPPED]):
        return Stopped(tuple(data[1:]))
    if data[:1] != bytes([_REPLY]) or len(data) < 4:
        return None
    more = len(data) > 4 and data[4] != 0
    return Reply(data[1], data[2], data[3], more, bytes(data[5:]))


def parse_settings(parameters: bytes) -> dict[Setting, tuple[float, ...]]:
    """Parse settings, each with its available or chosen values.

    Parsing stops at the first unknown setting, because its size is unknown. A factor that is not
    finite is left out.
    """
    found: dict[Setting, tuple[float, ...]] = {}
    position = 0
    while position + 2 <= len(parameters) and parameters[position] in _SIZES:
        setting, count = Setting(parameters[position]), parameters[position + 1]
        begin, size = position + 2, _SIZES[parameters[position]]
        position = begin + count * size
        if position > len(parameters):
            break
        raw = [parameters[at : at + size] for at in range(begin, position, size)]
        values = [_value(setting, each) for each in raw]
        found[setting] = tuple(value for value in values if isfinite(value))
    return found


def get_settings(measurement: Measurement) -> bytes:
    """Return the command that queries the settings of a measurement."""
    return bytes([Operation.GET_SETTINGS, measurement])


def start(measurement: Measurement, chosen: Mapping[Setting, int]) -> bytes:
    """Return the command that starts a measurement, with one value for each setting."""
    command = bytes([Operation.START, measurement])
    for setting, value in sorted(chosen.items()):
        command += bytes([setting, 1]) + struct.pack(f"<{_FORMATS[setting]}", value)
    return command


def stop(measurement: Measurement) -> bytes:
    """Return the command that stops a measurement."""
    return bytes([Operation.STOP, measurement])


def choose(
    offered: Mapping[Setting, Sequence[float]], wanted: Mapping[Setting, int]
) -> dict[Setting, int]:
    """Choose one value for each setting of a start command.

    The wanted value if available, else the next lower one, else the lowest; the highest if no
    value is wanted.
    """
    chosen: dict[Setting, int] = {}
    for setting, offers in offered.items():
        values = [int(value) for value in offers]
        if setting not in _FORMATS or not values:
            continue
        limit = wanted.get(setting, max(values))
        chosen[setting] = max((value for value in values if value <= limit), default=min(values))
    return chosen


def _value(setting: Setting, raw: bytes) -> float:
    if setting is Setting.FACTOR:
        (factor,) = _FACTOR_FORMAT.unpack(raw)
        return float(factor)
    return int.from_bytes(raw, "little")
