"""Encodes what a BioHarness 3 sends, and reads what a host sends.

Written from the vendor's layout alone and shared with no decoder, so that a
mistake in one of them shows as a disagreement. Sources of the layouts: real
captures and the BSD-2 project zephyr-bt; App-Zephyr of labstreaminglayer for the
100 mg acceleration packet (0x2A), which no capture holds.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
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
    """Message ids that the device sends without being asked each time."""

    GENERAL = 0x20
    BREATHING = 0x21
    ECG = 0x22
    LIFESIGN = 0x23
    RR = 0x24
    ACCELERATION = 0x25
    ACCELERATION_100MG = 0x2A
    SUMMARY = 0x2B
    EVENT = 0x2C


REQUESTS: Mapping[int, Packet] = MappingProxyType(
    {
        0x14: Packet.GENERAL,
        0x15: Packet.BREATHING,
        0x16: Packet.ECG,
        0x19: Packet.RR,
        0x1E: Packet.ACCELERATION,
        0xBC: Packet.ACCELERATION_100MG,
        0xBD: Packet.SUMMARY,
    }
)
"""Request id → the periodic packet that it switches."""


class WaveformLayout(NamedTuple):
    """Samples in a packet: how many, of how many channels, how far apart."""

    samples: int
    channels: int
    period_ms: int


WAVEFORMS: Mapping[Packet, WaveformLayout] = MappingProxyType(
    {
        Packet.BREATHING: WaveformLayout(18, 1, 56),
        Packet.ECG: WaveformLayout(63, 1, 4),
        Packet.RR: WaveformLayout(18, 1, 56),
        Packet.ACCELERATION: WaveformLayout(20, 3, 20),
        Packet.ACCELERATION_100MG: WaveformLayout(20, 3, 20),
    }
)


def duration_ms(packet: Packet) -> int:
    """Return the time that one periodic packet covers [ms]."""
    if packet in WAVEFORMS:
        return WAVEFORMS[packet].samples * WAVEFORMS[packet].period_ms
    return 1000


class DeviceStamp(NamedTuple):
    """The device's naive local clock, as the packets carry it."""

    day: date
    ms_of_day: int

    def plus(self, milliseconds: int) -> DeviceStamp:
        """Return the reading so many milliseconds later (or earlier)."""
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
    """Return a whole frame; the check covers the payload only."""
    return bytes((STX, message_id, len(payload), *payload, crc8(payload), end))


def with_wrong_check(data: bytes) -> bytes:
    """Return a frame whose check is another than that of its payload."""
    return data[:-2] + bytes((data[-2] ^ 0xFF, data[-1]))


def response(request_id: int, *, accepted: bool) -> bytes:
    """Return the answer to a request: ACK or NAK, without data."""
    return frame(request_id, end=ACK if accepted else NAK)


def pack_10_bit(values: Sequence[int]) -> bytes:
    """Return 10-bit values packed LSB-first, negative ones as two's complement."""
    stream = sum((value & 0x3FF) << (10 * k) for k, value in enumerate(values))
    return stream.to_bytes((10 * len(values) + 7) // 8, "little")


def header(sequence: int, stamp: DeviceStamp) -> bytes:
    """Return the nine bytes that every periodic packet and event begins with."""
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
        If the number of values is not the packet's.
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
    """What a host asked for; not ``intact`` if length, check or end were wrong."""

    request_id: int
    payload: bytes
    intact: bool


class RequestReader:
    """Cuts a host's byte stream into requests; keeps at most one unfinished one."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._fed_at = -inf

    def feed(self, data: bytes, now: float) -> list[Request]:
        """Return the requests that ``data``, heard at ``now`` [s], completes."""
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
        # Without its end mark the length itself is in doubt: look for the next start inside.
        del buffer[: length + 5 if end == ETX else 1]
        return Request(request_id, payload, intact=end == ETX and check == crc8(payload))
