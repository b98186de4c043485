"""Encodes the commands, settings and frames of Polar's measurement data (PMD) service.

All integers are little-endian. The layouts are from the Polar Measurement Data specification in
Polar's public SDK repository.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import IntEnum, unique
from itertools import cycle, islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SERVICE_UUID = "FB005C80-02E7-F387-1CAD-8ACD2D8DF0C8"
CONTROL_POINT_UUID = "FB005C81-02E7-F387-1CAD-8ACD2D8DF0C8"
DATA_UUID = "FB005C82-02E7-F387-1CAD-8ACD2D8DF0C8"

FULL_MTU = 232
"""ATT MTU for which the device is designed; a larger one does not make its frames longer."""
ATT_HEADER_BYTES = 3
_FEATURES_BYTES = 17


@unique
class Measurement(IntEnum):
    """Measurements, and modes that are switched like measurements."""

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
    """Result of a command."""

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
"""Available values by setting."""


def encode_settings(offered: Offered) -> bytes:
    """Encode settings as type, count and values, in the order of the mapping."""
    return b"".join(
        bytes((setting, len(values)))
        + b"".join(value.to_bytes(_SIZES[setting], "little") for value in values)
        for setting, values in offered.items()
    )


def decode_choice(data: bytes) -> dict[Setting, int]:
    """Decode the settings of a start command, each with exactly one value.

    Raises
    ------
    ValueError
        If a setting is unknown or repeated, or does not have one value.
    EOFError
        If the last setting is truncated.
    """
    chosen: dict[Setting, int] = {}
    while data:
        setting = Setting(data[0])
        end = 2 + _SIZES[setting]
        if data[1:2] not in (b"", b"\1") or setting in chosen:
            raise ValueError(f"{setting.name} is repeated or has not one value")
        if len(data) < end:
            raise EOFError(f"{setting.name} is truncated")
        chosen[setting] = int.from_bytes(data[2:end], "little")
        data = data[end:]
    return chosen


def encode_factor(factor: float) -> bytes:
    """Encode the setting with the size of a count, as in a reply to a start."""
    return bytes((Setting.FACTOR, 1)) + struct.pack("<f", factor)


def encode_features(measurements: Iterable[Measurement]) -> bytes:
    """Return the control point's value, 17 bytes."""
    mask = sum(1 << measurement for measurement in set(measurements))
    return (b"\x0f" + mask.to_bytes(2, "little")).ljust(_FEATURES_BYTES, b"\0")


HEADER_BYTES = 10
_COMPRESSED = 0x80
ACC_16_BIT = 1
"""Format of acceleration with 16 bits per axis [mg]."""
ACC_COMPRESSED_COUNTS, ACC_COMPRESSED_MG = 0x80, 0x81
"""Compressed 16-bit formats: in counts to be scaled, and in mg."""
PPG_OF_THREE_LEDS, PPG_OF_TWO_DIODES = 0x80, 0x8D
"""Compressed light: three LEDs and ambient light, or one LED with two photodiodes."""
_UNKNOWN_FORMAT = 0x3F

# Compressed samples consist of a complete reference sample and blocks: bits per difference, number
# of samples, and the differences from the previous sample, least significant bit first, channel by
# channel. Each block starts at a byte boundary.
Integers = NDArray[np.int64]

_BLOCK_SAMPLES = 12
"""Number of samples with a common width."""


def compress(samples: Integers, resolution: int) -> bytes:
    """Encode samples.

    Parameters
    ----------
    samples : ndarray of int64, shape (n, channels)
        At least one sample.
    resolution
        Bits of a sample.
    """
    reference = little_endian(samples[:1], -(-resolution // 8))
    differences = np.diff(samples, axis=0)
    starts = range(0, len(differences), _BLOCK_SAMPLES)
    return reference + b"".join(block(differences[at : at + _BLOCK_SAMPLES]) for at in starts)


def block(differences: Integers) -> bytes:
    """Encode one block, with as few bits per difference as possible."""
    bits = _width(differences)
    unsigned = differences.reshape(-1, 1) & ((1 << bits) - 1)
    stream = (unsigned >> np.arange(bits)) & 1
    payload = np.packbits(stream.astype(np.uint8).ravel(), bitorder="little")
    return bytes((bits, len(differences))) + payload.tobytes()


def little_endian(values: Integers, size: int) -> bytes:
    """Encode signed integers with `size` bytes each."""
    eight = np.ascontiguousarray(values, dtype="<i8").view(np.uint8).reshape(-1, 8)
    return eight[:, :size].tobytes()


def _width(differences: Integers) -> int:
    """Return the number of bits needed for all differences with their signs."""
    magnitude = np.where(differences < 0, ~differences, differences)
    return int(magnitude.max(initial=0)).bit_length() + 1


# The sensor can tell contact, and has it; nobody moved.
_ON_THE_SKIN = 0b110


class PulseInterval(NamedTuple):
    """One interval between two pulses."""

    bpm: int  # Heart rate [1/min].
    # interval_ms, error_ms: length and its estimated error [ms].
    interval_ms: int
    error_ms: int


def header(measurement: Measurement, timestamp_ns: int, frame_format: int) -> bytes:
    """Return the header of a frame, ten bytes."""
    return struct.pack("<BQB", measurement, timestamp_ns, frame_format)


def ecg(timestamp_ns: int, microvolts: Integers) -> bytes:
    """Return a frame of ECG, format 0: 24 bits [uV], shape (n, 1)."""
    return header(Measurement.ECG, timestamp_ns, 0) + little_endian(microvolts, 3)


def acceleration(timestamp_ns: int, counts: Integers, frame_format: int = ACC_16_BIT) -> bytes:
    """Return a frame of acceleration in one of the formats above, shape (n, 3)."""
    head = header(Measurement.ACC, timestamp_ns, frame_format)
    if frame_format & _COMPRESSED:
        return head + compress(counts, 16)
    return head + little_endian(counts, frame_format + 1)


def ppg(timestamp_ns: int, counts: Integers, frame_format: int = PPG_OF_THREE_LEDS) -> bytes:
    """Return a frame of light in one of the formats above, shape (n, 4) or (n, 2).

    After the values of two diodes follow status bits, which are all zero here.
    """
    head = header(Measurement.PPG, timestamp_ns, frame_format)
    if frame_format == PPG_OF_TWO_DIODES:
        status = np.zeros((len(counts), 1), np.int64)
        return head + compress(np.hstack((counts, status)), 24)
    return head + compress(counts, 22)


def angular_velocity(timestamp_ns: int, counts: Integers) -> bytes:
    """Return a compressed frame of angular velocity, 16 bits, shape (n, 3)."""
    return header(Measurement.GYRO, timestamp_ns, _COMPRESSED) + compress(counts, 16)


def magnetic_field(timestamp_ns: int, counts: Integers) -> bytes:
    """Return a compressed frame of magnetic flux density, 16 bits, shape (n, 3)."""
    return header(Measurement.MAGNETOMETER, timestamp_ns, _COMPRESSED) + compress(counts, 16)


def pulse_intervals(timestamp_ns: int, intervals: Sequence[PulseInterval]) -> bytes:
    """Return a frame of pulse-to-pulse intervals, format 0; its time is often 0."""
    entries = (
        struct.pack("<BHHB", one.bpm, one.interval_ms, one.error_ms, _ON_THE_SKIN)
        for one in intervals
    )
    return header(Measurement.PPI, timestamp_ns, 0) + b"".join(entries)


def damaged(rng: np.random.Generator, count: int) -> Iterator[bytes]:
    """Yield frames that cannot be decoded, each kind in turn, at most 20 bytes long."""
    time_ns = int(rng.integers(1 << 60))
    compressed = header(Measurement.ACC, time_ns, ACC_COMPRESSED_MG)
    kinds = (
        rng.bytes(int(rng.integers(HEADER_BYTES))),
        header(Measurement.ECG, time_ns, 0) + rng.bytes(3 * 3 + 1),
        header(Measurement.ACC, time_ns, ACC_16_BIT) + rng.bytes(6 + 2),
        compressed + rng.bytes(5),
        # Announces more differences than follow.
        compressed + rng.bytes(6) + b"\x10\x20" + rng.bytes(2),
        header(Measurement.ECG, time_ns, _UNKNOWN_FORMAT) + rng.bytes(9),
        header(Measurement.OFFLINE_HEART_RATE, time_ns, 0) + rng.bytes(9),
    )
    return islice(cycle(kinds), count)


def in_unknown_format(frame: bytes) -> bytes:
    """Return a frame whose header has an undocumented format."""
    return frame[: HEADER_BYTES - 1] + bytes((_UNKNOWN_FORMAT,)) + frame[HEADER_BYTES:]
