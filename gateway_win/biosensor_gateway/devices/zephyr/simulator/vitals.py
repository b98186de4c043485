"""The two packets of vital signs that a BioHarness 3 sends, encoded from field tables.

Layouts: summary version 2 (0x2B) from real captures and zephyr-bt; general data
(0x20), which no capture holds, from App-Zephyr of labstreaminglayer.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from biosensor_gateway.devices.zephyr.simulator.wire import DeviceStamp, Packet, frame, header

Values = Mapping[str, float | None]
"""Field name (its unit is the suffix) → value; None or absent is "invalid"."""


@dataclass(frozen=True)
class _Field:
    offset: int
    code: str
    counts_per_unit: float
    invalid: int


def _u16(offset: int, counts_per_unit: float = 1, invalid: int = 0xFFFF) -> _Field:
    return _Field(offset, "<H", counts_per_unit, invalid)


def _i16(offset: int, counts_per_unit: float = 1) -> _Field:
    return _Field(offset, "<h", counts_per_unit, -0x8000)


def _byte(offset: int, code: str, invalid: int) -> _Field:
    return _Field(offset, code, 1, invalid)


def _axes(offset: int) -> dict[str, _Field]:
    """Lay out minimum and peak of the three axes from ``offset`` on."""
    names = [
        f"{axis}_{end}_g" for axis in ("vertical", "lateral", "sagittal") for end in ("min", "peak")
    ]
    return {name: _i16(offset + 2 * k, 100) for k, name in enumerate(names)}


_SUMMARY_V2_LENGTH = 71
_SUMMARY_V2: Mapping[str, _Field] = MappingProxyType(
    {
        "version": _byte(9, "<B", 2),
        "heart_rate_bpm": _u16(10),
        "respiration_rate_bpm": _u16(12, 10),
        "skin_temperature_c": _i16(14, 10),
        "posture_deg": _i16(16),
        "activity_vmu_g": _u16(18, 100),
        "peak_accel_g": _u16(20, 100),
        "battery_v": _u16(22, 1000),
        "battery_percent": _byte(24, "<B", 0xFF),
        "breathing_wave_amplitude": _u16(25),
        "breathing_wave_noise": _u16(27),
        "breathing_rate_confidence": _byte(29, "<B", 0xFF),
        "ecg_amplitude_v": _u16(30, 1e6),
        "ecg_noise_v": _u16(32, 1e6),
        "heart_rate_confidence": _byte(34, "<B", 0xFF),
        "hrv_ms": _u16(35),
        "system_confidence": _byte(37, "<B", 0xFF),
        "gsr_ns": _u16(38),
        "rog": _u16(40, invalid=0),
        **_axes(42),
        "device_temperature_c": _i16(54, 10),
        "status_info": _u16(56, invalid=0),
        "link_quality": _byte(58, "<B", 0xFF),
        "rssi_db": _byte(59, "<b", -128),
        "tx_power_dbm": _byte(60, "<b", -128),
        "core_temperature_c": _u16(61, 10),
        "aux_adc_1": _u16(63),
        "aux_adc_2": _u16(65),
        "aux_adc_3": _u16(67),
        "reserved": _u16(69, invalid=0),
    }
)

_GENERAL_LENGTH = 53
_GENERAL: Mapping[str, _Field] = MappingProxyType(
    {
        "heart_rate_bpm": _u16(9),
        "respiration_rate_bpm": _u16(11, 10),
        "skin_temperature_c": _i16(13, 10),
        "posture_deg": _i16(15),
        "activity_vmu_g": _u16(17, 100),
        "peak_accel_g": _u16(19, 100),
        "battery_v": _u16(21, 1000),
        "breathing_wave_amplitude": _u16(23),
        "ecg_amplitude_v": _u16(25, 1e6),
        "ecg_noise_v": _u16(27, 1e6),
        **_axes(29),
        "system_channel": _u16(41, invalid=0),
        "gsr_ns": _u16(43),
        "unused_1": _u16(45, invalid=0),
        "unused_2": _u16(47, invalid=0),
        "rog": _byte(49, "<B", 0),
        "alarm": _byte(50, "<B", 0),
        "battery_percent": _byte(51, "<B", 0),
        "flags": _byte(52, "<B", 0),
    }
)


def _fields(layout: Mapping[str, _Field], length: int, head: bytes, values: Values) -> bytes:
    unknown = values.keys() - layout.keys()
    if unknown:
        raise ValueError(f"no such fields: {sorted(unknown)}")
    payload = bytearray(head.ljust(length, b"\0"))
    for name, field in layout.items():
        value = values.get(name)
        raw = field.invalid if value is None else round(value * field.counts_per_unit)
        struct.pack_into(field.code, payload, field.offset, raw)
    return bytes(payload)


def summary_v2(sequence: int, stamp: DeviceStamp, values: Values) -> bytes:
    """Return a summary packet's frame, version 2.

    Raises
    ------
    ValueError
        If a name is not a field of the packet.
    struct.error
        If a value does not fit its field.
    """
    payload = _fields(_SUMMARY_V2, _SUMMARY_V2_LENGTH, header(sequence, stamp), values)
    return frame(Packet.SUMMARY, payload)


def general(sequence: int, stamp: DeviceStamp, values: Values) -> bytes:
    """Return a general data packet's frame; errors as for `summary_v2`."""
    payload = _fields(_GENERAL, _GENERAL_LENGTH, header(sequence, stamp), values)
    return frame(Packet.GENERAL, payload)
