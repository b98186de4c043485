"""Bluetooth heart-rate profile: characteristic values in, typed records out; no I/O, no clock.

Layouts are those of the Bluetooth SIG's GATT Specification Supplement [1]_.

.. [1] Bluetooth SIG, GATT Specification Supplement, "Heart Rate Measurement",
   "Battery Level"; Device Information Service 1.1.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass


def _assigned(number: int) -> str:
    return f"0000{number:04x}-0000-1000-8000-00805f9b34fb"


HEART_RATE_SERVICE = _assigned(0x180D)
HEART_RATE_MEASUREMENT = _assigned(0x2A37)
BATTERY_LEVEL = _assigned(0x2A19)
MANUFACTURER_NAME = _assigned(0x2A29)
MODEL_NUMBER = _assigned(0x2A24)
SERIAL_NUMBER = _assigned(0x2A25)
FIRMWARE_REVISION = _assigned(0x2A26)

INTERVALS_PER_SECOND = 1024
_SATURATED = 0xFFFF

_RATE_IS_16_BIT = 1 << 0
_IN_CONTACT = 1 << 1
_CONTACT_SUPPORTED = 1 << 2
_HAS_ENERGY = 1 << 3
_HAS_INTERVALS = 1 << 4


@dataclass(frozen=True, slots=True)
class HeartRateMeasurement:
    """A measurement, which straps send about once a second."""

    bpm: int  # Heart rate [1/min]; 0 = no reading.
    contact: bool | None  # Whether there is skin contact; None if not reported.
    energy_kj: int | None  # Energy expended since the last reset [kJ]; None if not reported.
    # R-R intervals that ended since the last measurement [1/1024 s], oldest first.
    intervals: tuple[int, ...]

    @property
    def intervals_s(self) -> tuple[float, ...]:
        """R-R intervals in seconds."""
        return _in_seconds(self.intervals)

    @property
    def is_saturated(self) -> bool:
        """Whether an interval exceeds the range of the field, 64 s, or has no value."""
        return _SATURATED in self.intervals

    @property
    def intervals_s_since_saturation(self) -> tuple[float, ...]:
        """R-R intervals in seconds after the last one of unknown length."""
        from_end = self.intervals[::-1]
        return _in_seconds(self.intervals[len(from_end) - from_end.index(_SATURATED) :])


def _in_seconds(intervals: tuple[int, ...]) -> tuple[float, ...]:
    return tuple(interval / INTERVALS_PER_SECOND for interval in intervals)


def parse_measurement(data: bytes) -> HeartRateMeasurement | None:
    """Parse a Heart Rate Measurement; None if it is truncated.

    A surplus byte after the intervals and reserved flags are ignored.
    """
    flags = data[0] if data else 0
    rate = "H" if flags & _RATE_IS_16_BIT else "B"
    layout = struct.Struct(f"<B{rate}{'H' if flags & _HAS_ENERGY else ''}")
    if len(data) < layout.size:
        return None
    _, bpm, *energy = layout.unpack_from(data)
    rest = data[layout.size :] if flags & _HAS_INTERVALS else b""
    return HeartRateMeasurement(
        bpm=bpm,
        contact=bool(flags & _IN_CONTACT) if flags & _CONTACT_SUPPORTED else None,
        energy_kj=energy[0] if energy else None,
        intervals=struct.unpack_from(f"<{len(rest) // 2}H", rest),
    )


def parse_battery_level(data: bytes) -> int | None:
    """Parse a Battery Level in percent; None if it is invalid."""
    return data[0] if data and data[0] <= 100 else None


def parse_text(data: bytes) -> str:
    """Parse a text of the Device Information service, without unprintable characters."""
    text = data.decode("utf-8", errors="ignore")
    return "".join(character for character in text if character.isprintable()).strip()
