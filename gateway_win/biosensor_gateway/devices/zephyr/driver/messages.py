"""The messages of a BioHarness as records."""

from __future__ import annotations

import datetime as dt
import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

Number = int | float | None


class MessageId(IntEnum):
    """Messages that the device sends without a request."""

    GENERAL = 0x20
    BREATHING = 0x21
    ECG = 0x22
    LIFESIGN = 0x23
    RR = 0x24
    ACCELERATION = 0x25
    ACCELERATION_100MG = 0x2A
    SUMMARY = 0x2B
    EVENT = 0x2C


class Field(NamedTuple):
    """One number: ``raw / divisor``, or None where raw is the "invalid" pattern."""

    name: str
    offset: int
    code: str
    divisor: int = 1
    invalid: int | None = None


_U16, _I16, _U8, _I8 = 0xFFFF, -0x8000, 0xFF, -0x80


def _axes(offset: int) -> tuple[Field, ...]:
    ends = [
        f"{axis}_{end}" for axis in ("vertical", "lateral", "sagittal") for end in ("min", "peak")
    ]
    return tuple(Field(f"{end}_g", offset + 2 * i, "h", 100, _I16) for i, end in enumerate(ends))


GENERAL = (
    Field("heart_rate_bpm", 9, "H", 1, _U16),
    Field("respiration_rate_bpm", 11, "H", 10, _U16),
    Field("skin_temperature_c", 13, "h", 10, _I16),
    Field("posture_deg", 15, "h", 1, _I16),
    Field("activity_vmu_g", 17, "H", 100, _U16),
    Field("peak_accel_g", 19, "H", 100, _U16),
    Field("battery_v", 21, "H", 1000, _U16),
    Field("breathing_wave_amplitude", 23, "H", 1, _U16),
    Field("ecg_amplitude_v", 25, "H", 1_000_000, _U16),
    Field("ecg_noise_v", 27, "H", 1_000_000, _U16),
    *_axes(29),
    Field("system_channel", 41, "H"),
    Field("gsr_ns", 43, "H", 1, _U16),
    Field("rog", 49, "B"),
    Field("alarm", 50, "B"),
)

SUMMARY_V2 = (
    Field("heart_rate_bpm", 10, "H", 1, _U16),
    Field("respiration_rate_bpm", 12, "H", 10, _U16),
    Field("skin_temperature_c", 14, "h", 10, _I16),
    Field("posture_deg", 16, "h", 1, _I16),
    Field("activity_vmu_g", 18, "H", 100, _U16),
    Field("peak_accel_g", 20, "H", 100, _U16),
    Field("battery_v", 22, "H", 1000, _U16),
    Field("battery_percent", 24, "B", 1, _U8),
    Field("breathing_wave_amplitude", 25, "H", 1, _U16),
    Field("breathing_wave_noise", 27, "H", 1, _U16),
    Field("breathing_rate_confidence", 29, "B", 1, _U8),
    Field("ecg_amplitude_v", 30, "H", 1_000_000, _U16),
    Field("ecg_noise_v", 32, "H", 1_000_000, _U16),
    Field("heart_rate_confidence", 34, "B", 1, _U8),
    Field("hrv_ms", 35, "H", 1, _U16),
    Field("system_confidence", 37, "B", 1, _U8),
    Field("gsr_ns", 38, "H", 1, _U16),
    *_axes(42),
    Field("device_temperature_c", 54, "h", 10, _I16),
    Field("link_quality", 58, "B", 1, _U8),
    Field("rssi_db", 59, "b", 1, _I8),
    Field("tx_power_dbm", 60, "b", 1, _I8),
    Field("core_temperature_c", 61, "H", 10, _U16),
    Field("aux_adc_1", 63, "H", 1, _U16),
    Field("aux_adc_2", 65, "H", 1, _U16),
    Field("aux_adc_3", 67, "H", 1, _U16),
)

SUMMARY_V3 = (
    Field("heart_rate_bpm", 10, "H", 1, _U16),
    Field("respiration_rate_bpm", 12, "H", 10, _U16),
    Field("posture_deg", 14, "h", 1, _I16),
    Field("activity_vmu_g", 16, "H", 100, _U16),
    Field("peak_accel_g", 18, "H", 100, _U16),
    Field("battery_percent", 20, "B", 1, _U8),
    Field("breathing_wave_amplitude", 21, "H", 1, _U16),
    Field("ecg_amplitude_v", 23, "H", 1_000_000, _U16),
    Field("ecg_noise_v", 25, "H", 1_000_000, _U16),
    Field("heart_rate_confidence", 27, "B", 1, _U8),
    Field("hrv_ms", 28, "H", 1, _U16),
    Field("link_quality", 34, "B", 1, _U8),
    Field("rssi_db", 35, "b", 1, _I8),
    Field("tx_power_dbm", 36, "b", 1, _I8),
    Field("core_temperature_c", 37, "H", 10, _U16),
)

# Layout by version: numbers, offset of the "red orange green" word, offset of the status word.
SUMMARY_LAYOUTS = {2: (SUMMARY_V2, 40, 56), 3: (SUMMARY_V3, 30, 32)}


def read_fields(fields: tuple[Field, ...], payload: bytes) -> dict[str, Number]:
    """Decode the numbers of a layout from a payload."""
    numbers: dict[str, Number] = {}
    for name, offset, code, divisor, invalid in fields:
        (raw,) = struct.unpack_from("<" + code, payload, offset)
        if raw == invalid:
            numbers[name] = None
        else:
            numbers[name] = raw if divisor == 1 else raw / divisor
    return numbers


def read_bits(payload: bytes, names: tuple[tuple[str, int], ...]) -> dict[str, int]:
    """Decode consecutive bit fields, least significant bit first.

    Parameters
    ----------
    names
        Name and width in bits of each field, in order.
    """
    bits = int.from_bytes(payload, "little")
    values: dict[str, int] = {}
    for name, width in names:
        values[name] = bits & ((1 << width) - 1)
        bits >>= width
    return values


GPS_OFFSET, GPS_SIZE, SPEED_OFFSET = 39, 10, 49
GPS = (
    ("lat_deg", 7),
    ("lat_min", 6),
    ("lat_dec_min", 14),
    ("lat_dir", 1),
    ("lon_deg", 8),
    ("lon_min", 6),
    ("lon_dec_min", 14),
    ("lon_dir", 1),
    ("quality", 1),
    ("altitude", 15),
    ("hdop", 6),
)
MOVEMENT_OFFSET = 51
MOVEMENT = (
    ("impulse_load_ns", 20),
    ("walk_steps", 18),
    ("run_steps", 18),
    ("bounds", 10),
    ("jumps", 10),
    ("impacts_3g", 10),
    ("impacts_7g", 10),
    ("avg_rate_of_force", 12),
    ("avg_step_impulse", 10),
    ("avg_step_period_s", 10),
    ("last_jump_flight_s", 8),
    ("peak_accel_phi", 8),
    ("peak_accel_theta", 10),
)
MOVEMENT_DIVISORS = {
    "avg_rate_of_force": 100,
    "avg_step_impulse": 100,
    "avg_step_period_s": 1000,
    "last_jump_flight_s": 100,
}


# A zero of 512 gives 1.07 g at rest in recordings; the data sheet's alternative 533 gives 2.4 g.
ACCELERATION_ZERO = 512
ACCELERATION_COUNTS_PER_G = 20.75

_EPOCH = dt.datetime(2000, 1, 1)  # noqa: DTZ001 - the device's clock is naive local time


@dataclass(frozen=True, slots=True)
class Header:
    """The header of periodic packets."""

    sequence: int  # Counter of packets of one kind, 0-255.
    time: dt.datetime | None  # Device clock, naive local time of the first sample; None if not set.

    @property
    def device_s(self) -> float | None:
        """Device clock in seconds since 2000-01-01, None if it is not set."""
        return None if self.time is None else (self.time - _EPOCH).total_seconds()


@dataclass(frozen=True, slots=True)
class Waveform:
    """ECG (63 samples, 4 ms apart) or breathing (18 samples, 56 ms), in counts 0-1023."""

    message_id: MessageId
    header: Header
    samples: tuple[int, ...]
    period_s: float


@dataclass(frozen=True, slots=True)
class Acceleration:
    """20 samples of (X, Y, Z) in counts, 20 ms apart.

    ``counts_per_g`` and ``zero`` convert them to g: ``(counts - zero) / counts_per_g``.
    """

    header: Header
    samples: tuple[tuple[int, int, int], ...]
    counts_per_g: float = ACCELERATION_COUNTS_PER_G
    zero: int = ACCELERATION_ZERO


@dataclass(frozen=True, slots=True)
class RrIntervals:
    """18 readings of the last R-R interval in ms, 56 ms apart; the sign flips at each beat."""

    header: Header
    samples: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Status:
    """Status word of the summary packet; "unreliable" flags do not make a value invalid."""

    word: int

    def _bit(self, number: int) -> bool:
        return bool(self.word >> number & 1)

    @property
    def worn_level(self) -> int:
        """Confidence that it is worn: 0 full, 1 high, 2 low; 3 not worn."""
        return self.word & 3

    @property
    def worn(self) -> bool:
        """Whether the device reports that it is worn."""
        return self.worn_level != 3

    @property
    def flags(self) -> dict[str, bool]:
        """All single-bit flags by name."""
        return {name: self._bit(number) for number, name in enumerate(_STATUS_BITS, start=2)}


_STATUS_BITS = (
    "button",
    "not_fitted",
    "hr_unreliable",
    "rr_unreliable",
    "skin_temp_unreliable",
    "posture_unreliable",
    "activity_unreliable",
    "hrv_unreliable",
    "core_temp_unreliable",
)


@dataclass(frozen=True, slots=True)
class Summary:
    """Vital signs, once a second."""

    header: Header
    version: int
    numbers: dict[str, Number]  # Decoded numbers by name, unit in the name, None where invalid.
    status: Status
    # rog_status, rog_time_s: "Red orange green" state of the wearer and the seconds spent in it.
    rog_status: str
    rog_time_s: int
    # GPS and movement bit fields of version 3, empty in version 2.
    extra: dict[str, dict[str, int | float]]


@dataclass(frozen=True, slots=True)
class General:
    """Vital signs of devices without summary packets (BioHarness 2)."""

    header: Header
    numbers: dict[str, Number]
    battery_percent: int
    worn: bool
    button: bool
    hr_signal_low: bool
    external_sensors: bool


@dataclass(frozen=True, slots=True)
class Event:
    """An event on the device, with its time."""

    header: Header
    code: int
    name: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer to a request of the same id."""

    request_id: int
    accepted: bool
    data: bytes


@dataclass(frozen=True, slots=True)
class Lifesign:
    """A sign that the device is running."""


@dataclass(frozen=True, slots=True)
class Unknown:
    """A valid frame of an unknown kind."""

    message_id: int


Message = (
    Waveform | Acceleration | RrIntervals | Summary | General | Event | Reply | Lifesign | Unknown
)
