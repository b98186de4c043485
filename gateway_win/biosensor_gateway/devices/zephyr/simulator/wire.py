"""Encodes a BioHarness 3's frames, and parses a host's requests.

It was written only from the vendor's layout and shares no code with the decoder, so that a mistake
in either shows as a difference. Sources of the layouts: real captures and the BSD-2 project
zephyr-bt; App-Zephyr of labstreaminglayer for the 100 mg acceleration packet (0x2A), which is in
no capture.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from enum import IntEnum, unique
from math import inf
from types import MappingProxyType
from typing import NamedTuple

STX, ETX, ACK, NAK = 0x02, 0x03, 0x06, 0x15
MAX_PAYLOAD = 128
LONGEST_PAUSE_IN_A_REQUEST_S = 1.0
MS_PER_DAY = 86_400_000


@unique
class Packet(IntEnum):
    """Message ids of packets that the device sends without individual requests."""

    GENERAL = 0x20
    BREATHING = 0x21
    ECG = 0x22
    LIFESIGN = 0x23
    RR = 0x24
    ACCELERATION = 0x25
    SUMMARY = 0x2B
    EVENT = 0x2C


REQUESTS: Mapping[int, Packet] = MappingProxyType(
    {
        0x14: Packet.GENERAL,
        0x15: Packet.BREATHING,
        0x16: Packet.ECG,
        0x19: Packet.RR,
        0x1E: Packet.ACCELERATION,
        0xBD: Packet.SUMMARY,
    }
)
"""Request id → the periodic packet that it switches."""


class WaveformLayout(NamedTuple):
    """Number of samples in a packet, channels, and sample period."""

    samples: int
    channels: int
    period_ms: int


WAVEFORMS: Mapping[Packet, WaveformLayout] = MappingProxyType(
    {
        Packet.BREATHING: WaveformLayout(18, 1, 56),
        Packet.ECG: WaveformLayout(63, 1, 4),
        Packet.RR: WaveformLayout(18, 1, 56),
        Packet.ACCELERATION: WaveformLayout(20, 3, 20),
    }
)


def duration_ms(packet: Packet) -> int:
    """Return the time that one periodic packet covers [ms]."""
    if packet in WAVEFORMS:
        return WAVEFORMS[packet].samples * WAVEFORMS[packet].period_ms
    return 1000


class DeviceStamp(NamedTuple):
    """The device's naive local time, as in packets."""

    day: date
    ms_of_day: int

    def plus(self, milliseconds: int) -> DeviceStamp:
        """Return the time this many milliseconds later or earlier."""
        days, ms_of_day = divmod(self.ms_of_day + milliseconds, MS_PER_DAY)
        return DeviceStamp(self.day + timedelta(days=days), ms_of_day)


def crc8(payload: bytes) -> int:
    """Return the frame check: CRC-8, reflected polynomial 0x8C, initial value 0."""
    crc = 0
    for byte in payload:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x8C if crc & 1 else 0)
    return crc


def frame(message_id: int, payload: bytes = b"", end: int = ETX) -> bytes:
    """Return a complete frame; the CRC covers the payload only."""
    return bytes((STX, message_id, len(payload), *payload, crc8(payload), end))


def with_wrong_check(data: bytes) -> bytes:
    """Return a frame with a wrong CRC."""
    return data[:-2] + bytes((data[-2] ^ 0xFF, data[-1]))


def response(request_id: int, *, accepted: bool) -> bytes:
    """Return the answer to a request: ACK or NAK, without data."""
    return frame(request_id, end=ACK if accepted else NAK)


def pack_10_bit(values: Sequence[int]) -> bytes:
    """Return 10-bit values packed LSB-first, negative ones as two's complement."""
    stream = sum((value & 0x3FF) << (10 * k) for k, value in enumerate(values))
    return stream.to_bytes((10 * len(values) + 7) // 8, "little")


def header(sequence: int, stamp: DeviceStamp) -> bytes:
    """Return the nine-byte header of periodic packets and events."""
    day = stamp.day
    return struct.pack("<BHBBI", sequence & 0xFF, day.year, day.month, day.day, stamp.ms_of_day)


def waveform(packet: Packet, sequence: int, stamp: DeviceStamp, values: Sequence[int]) -> bytes:
    """Return a waveform packet's frame.

    Parameters
    ----------
    packet
        One of `WAVEFORMS`.
    sequence, stamp
        Packet number (its low 8 bits are sent) and time of the first sample.
    values
        All values, channels interleaved: counts, or for `Packet.RR` signed
        milliseconds.

    Raises
    ------
    ValueError
        If the number of values is wrong.
    """
    layout = WAVEFORMS[packet]
    if len(values) != layout.samples * layout.channels:
        raise ValueError(f"{packet.name} takes {layout}, not {len(values)} values")
    data = struct.pack("<18h", *values) if packet is Packet.RR else pack_10_bit(values)
    return frame(packet, header(sequence, stamp) + data)


def event(sequence: int, stamp: DeviceStamp, code: int, data: bytes = b"") -> bytes:
    """Return an event's frame; ``code`` is type << 12 | source << 6 | id."""
    return frame(Packet.EVENT, header(sequence, stamp) + struct.pack("<H", code) + data)


class Request(NamedTuple):
    """A host's request; not ``intact`` if length, CRC or end were wrong."""

    request_id: int
    payload: bytes
    intact: bool


class RequestReader:
    """Splits a host's byte stream into requests; buffers at most one incomplete request."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._fed_at = -inf

    def feed(self, data: bytes, now: float) -> list[Request]:
        """Return the requests completed by ``data``, received at ``now`` [s]."""
        if now - self._fed_at > LONGEST_PAUSE_IN_A_REQUEST_S:
            self._buffer.clear()
        self._fed_at = now
        self._buffer += data
        requests: list[Request] = []
        while (request := self._take()) is not None:
            requests.append(request)
        return requests

    def _take(self) -> Request | None:
        buffer = self._buffer
        start = buffer.find(STX)
        del buffer[: start if start >= 0 else len(buffer)]
        if len(buffer) < 3:
            return None
        request_id, length = buffer[1], buffer[2]
        if length > MAX_PAYLOAD:
            del buffer[0]
            return Request(request_id, b"", intact=False)
        if len(buffer) < length + 5:
            return None
        payload, check, end = bytes(buffer[3 : length + 3]), buffer[length + 3], buffer[length + 4]
        # Without its end mark the length is doubtful, so search for the next start inside.
        del buffer[: length + 5 if end == ETX else 1]
        return Request(request_id, payload, intact=end == ETX and check == crc8(payload))


Values = Mapping[str, float | None]
"""Values by field name, with the unit as suffix; None or absent means "invalid"."""


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
    """Return the fields for minimum and peak of the three axes, from ``offset`` on."""
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
