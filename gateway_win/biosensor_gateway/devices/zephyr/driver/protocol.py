"""Decodes the BioHarness 3 protocol; no I/O and no clock.

Layouts are as in zephyr-bt and App-Zephyr, confirmed by recordings of a real device. Unknown
messages are returned as :class:`Unknown` instead of raising.
"""

from __future__ import annotations

import datetime as dt
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from biosensor_gateway.devices.zephyr.driver import messages
from biosensor_gateway.devices.zephyr.driver.messages import (
    Acceleration,
    Event,
    General,
    Header,
    Lifesign,
    Message,
    MessageId,
    Reply,
    RrIntervals,
    Status,
    Summary,
    Unknown,
    Waveform,
    read_bits,
    read_fields,
)

STX = 0x02
MAX_PAYLOAD = 128
_OVERHEAD = 5
# Larger input is processed in slices, so the buffer stays small whatever arrives.
_SLICE = 1024


class Terminator(IntEnum):
    """Last byte of a frame; old firmware ends periodic packets with ACK too."""

    ETX = 0x03
    ACK = 0x06
    NAK = 0x15


_TERMINATORS = {int(end): end for end in Terminator}


HXM = 0x26
"""Message id of a Zephyr HxM, a strap that sends once a second and accepts no requests."""

PAYLOAD_SIZES: dict[int, range] = {
    MessageId.GENERAL: range(53, 54),
    MessageId.BREATHING: range(32, 33),
    MessageId.ECG: range(88, 89),
    MessageId.LIFESIGN: range(1),
    MessageId.RR: range(45, 46),
    MessageId.ACCELERATION: range(84, 85),
    MessageId.ACCELERATION_100MG: range(84, 85),
    MessageId.SUMMARY: range(71, 72),
    MessageId.EVENT: range(11, 32),
}
_ANY_SIZE = range(MAX_PAYLOAD + 1)


def _crc_table() -> bytes:
    table = bytearray(256)
    for index in range(256):
        crc = index
        for _ in range(8):
            crc = crc >> 1 ^ (0x8C if crc & 1 else 0)
        table[index] = crc
    return bytes(table)


_CRC = _crc_table()


def crc8(payload: bytes) -> int:
    """Return the CRC-8 of a payload; 0 for an empty one."""
    crc = 0
    for byte in payload:
        crc = _CRC[crc ^ byte]
    return crc


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame with correct length, CRC and end."""

    message_id: int
    payload: bytes
    terminator: Terminator


def request(message_id: int, payload: bytes = b"") -> bytes:
    """Return a request of the host."""
    return bytes((STX, message_id, len(payload), *payload, crc8(payload), Terminator.ETX))


class FrameParser:
    """Splits a byte stream into frames; other bytes are dropped and counted.

    After a rejected frame, only one byte is dropped before the search continues, because 02 may
    occur in a payload.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.dropped_bytes = 0

    @property
    def buffered(self) -> int:
        """Number of bytes held back as the possible start of a frame."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Frame]:
        """Add bytes in pieces of any size; return the frames that they complete."""
        frames: list[Frame] = []
        for start in range(0, len(data), _SLICE):
            self._buffer += data[start : start + _SLICE]
            self._scan(frames)
        return frames

    def give_up(self) -> list[Frame]:
        """Stop waiting for the rest of a frame; return frames found after its first byte."""
        frames: list[Frame] = []
        while self._buffer:
            del self._buffer[0]
            self.dropped_bytes += 1
            self._scan(frames)
        return frames

    def _scan(self, frames: list[Frame]) -> None:
        buffer = self._buffer
        position, end = 0, len(buffer)
        while position < end:
            start = buffer.find(STX, position)
            if start != position:
                start = end if start < 0 else start
                self.dropped_bytes += start - position
                position = start
                continue
            size = self._frame_size(position)
            if size is None:
                break
            found = self._frame(position, size) if size else None
            if found is None:
                self.dropped_bytes += 1
                position += 1
            else:
                frames.append(found)
                position += size
        del buffer[:position]

    def _frame_size(self, start: int) -> int | None:
        """Return the size of the frame at *start*: 0 if there is none, None if incomplete."""
        buffer = self._buffer
        if len(buffer) - start < 3:
            return None
        payload_size = buffer[start + 2]
        if payload_size not in PAYLOAD_SIZES.get(buffer[start + 1], _ANY_SIZE):
            return 0
        size = payload_size + _OVERHEAD
        return size if len(buffer) - start >= size else None

    def _frame(self, start: int, size: int) -> Frame | None:
        end = start + size
        terminator = _TERMINATORS.get(self._buffer[end - 1])
        payload = bytes(self._buffer[start + 3 : end - 2])
        if terminator is None or crc8(payload) != self._buffer[end - 2]:
            return None
        return Frame(self._buffer[start + 1], payload, terminator)


ECG_PERIOD_S = 0.004
BREATHING_PERIOD_S = 0.056
RR_PERIOD_S = 0.056
ACCELERATION_PERIOD_S = 0.02

_HEADER = struct.Struct("<BHBBI")
_HEADER_SIZE = 9
_MS_PER_DAY = 86_400_000
# A later year means that the clock is not set.
_LAST_YEAR = 2999


class Request(IntEnum):
    """The requests that the driver uses; others could erase or reconfigure the device."""

    GENERAL = 0x14
    BREATHING = 0x15
    ECG = 0x16
    RR = 0x19
    ACCELERATION = 0x1E
    LIFESIGN = 0x23
    SUMMARY = 0xBD


_REPLY_IDS = frozenset(Request) - {Request.LIFESIGN}
LIFESIGN = request(Request.LIFESIGN)


def enable(packet: Request, *, on: bool) -> bytes:
    """Return the request that switches a periodic packet on (summary: once a second) or off."""
    if packet is Request.SUMMARY:
        return request(packet, struct.pack("<H", int(on)))
    return request(packet, bytes((on,)))


EVENT_NAMES = {
    0x0040: "button_press",
    0x0041: "emergency_button",
    0x0080: "battery_low",
    0x00C0: "self_test",
    0x1000: "rog_change",
    0x1040: "worn_change",
    0x1080: "hr_reliability_change",
    0x10C0: "fall",
    0x1100: "jump",
    0x1140: "dash",
}
_ROG = {1: "green", 2: "orange", 3: "red"}


class ZephyrProtocol:
    """Incremental decoder of one connection's bytes.

    ``feed`` never raises, whatever the bytes; unusable bytes are counted.
    """

    def __init__(self) -> None:
        self._frames = FrameParser()

    @property
    def dropped_bytes(self) -> int:
        """Number of bytes outside of valid frames."""
        return self._frames.dropped_bytes

    @property
    def buffered(self) -> int:
        """Number of bytes held back as a possible start of a frame."""
        return self._frames.buffered

    def feed(self, data: bytes) -> list[Message]:
        """Add bytes in pieces of any size; return the messages that they complete."""
        return [decode(frame) for frame in self._frames.feed(data)]

    def give_up(self) -> list[Message]:
        """Discard an incomplete frame; call this after a second of silence."""
        return [decode(frame) for frame in self._frames.give_up()]


def decode(frame: Frame) -> Message:
    """Decode one frame."""
    decoder = _DECODERS.get(frame.message_id)
    if decoder is not None:
        return decoder(frame)
    # A mere echo of a request ends with ETX and is not an answer.
    if frame.message_id in _REPLY_IDS and frame.terminator is not Terminator.ETX:
        return Reply(frame.message_id, frame.terminator is Terminator.ACK, frame.payload)
    return Unknown(frame.message_id)


def unpack_10bit(payload: bytes, count: int) -> tuple[int, ...]:
    """Unpack *count* unsigned 10-bit samples, least significant bit first."""
    bits = int.from_bytes(payload, "little")
    return tuple(bits >> shift & 0x3FF for shift in range(0, 10 * count, 10))


def _header(payload: bytes) -> Header:
    sequence, year, month, day, ms_of_day = _HEADER.unpack_from(payload)
    if ms_of_day >= _MS_PER_DAY or year > _LAST_YEAR:
        return Header(sequence, None)
    try:
        midnight = dt.datetime(year, month, day)  # noqa: DTZ001 - naive, as the device means it
    except ValueError:
        return Header(sequence, None)
    return Header(sequence, midnight + dt.timedelta(milliseconds=ms_of_day))


def _ecg(frame: Frame) -> Waveform:
    samples = unpack_10bit(frame.payload[_HEADER_SIZE:], 63)
    return Waveform(MessageId.ECG, _header(frame.payload), samples, ECG_PERIOD_S)


def _breathing(frame: Frame) -> Waveform:
    samples = unpack_10bit(frame.payload[_HEADER_SIZE:], 18)
    return Waveform(MessageId.BREATHING, _header(frame.payload), samples, BREATHING_PERIOD_S)


def _triples(flat: tuple[int, ...]) -> tuple[tuple[int, int, int], ...]:
    return tuple(zip(flat[0::3], flat[1::3], flat[2::3], strict=True))


def _acceleration(frame: Frame) -> Acceleration:
    flat = unpack_10bit(frame.payload[_HEADER_SIZE:], 60)
    return Acceleration(_header(frame.payload), _triples(flat))


def _acceleration_100mg(frame: Frame) -> Acceleration:
    flat = unpack_10bit(frame.payload[_HEADER_SIZE:], 60)
    signed = tuple(count - 1024 if count >= 512 else count for count in flat)
    return Acceleration(_header(frame.payload), _triples(signed), counts_per_g=10, zero=0)


def _rr(frame: Frame) -> RrIntervals:
    samples = struct.unpack_from("<18h", frame.payload, _HEADER_SIZE)
    return RrIntervals(_header(frame.payload), samples)


def _summary(frame: Frame) -> Summary | Unknown:
    payload, version = frame.payload, frame.payload[9]
    layout = messages.SUMMARY_LAYOUTS.get(version)
    if layout is None:
        return Unknown(frame.message_id)
    table, rog_at, status_at = layout
    (rog,) = struct.unpack_from("<H", payload, rog_at)
    (status,) = struct.unpack_from("<H", payload, status_at)
    return Summary(
        header=_header(payload),
        version=version,
        numbers=read_fields(table, payload),
        status=Status(status),
        rog_status=_ROG.get(rog & 7, "invalid"),
        rog_time_s=rog >> 3,
        extra=_summary_extra(payload) if version == 3 else {},
    )


def _summary_extra(payload: bytes) -> dict[str, dict[str, int | float]]:
    end = messages.GPS_OFFSET + messages.GPS_SIZE
    gps: dict[str, int | float] = dict(read_bits(payload[messages.GPS_OFFSET : end], messages.GPS))
    gps["speed"] = struct.unpack_from("<H", payload, messages.SPEED_OFFSET)[0] & 0x3FFF
    bits = read_bits(payload[messages.MOVEMENT_OFFSET :], messages.MOVEMENT)
    if bits["peak_accel_theta"] >= 512:
        bits["peak_accel_theta"] -= 1024
    movement: dict[str, int | float] = {
        name: value / messages.MOVEMENT_DIVISORS[name]
        if name in messages.MOVEMENT_DIVISORS
        else value
        for name, value in bits.items()
    }
    return {"gps": gps, "movement": movement}


def _general(frame: Frame) -> General:
    battery, state = frame.payload[51], frame.payload[52]
    return General(
        header=_header(frame.payload),
        numbers=read_fields(messages.GENERAL, frame.payload),
        battery_percent=battery & 0x7F,
        worn=bool(state & 0x80),
        button=bool(state & 0x40),
        hr_signal_low=bool(state & 0x20),
        external_sensors=bool(state & 0x10),
    )


def _event(frame: Frame) -> Event:
    (code,) = struct.unpack_from("<H", frame.payload, _HEADER_SIZE)
    return Event(_header(frame.payload), code, EVENT_NAMES.get(code, "unknown"), frame.payload[11:])


def _lifesign(_: Frame) -> Lifesign:
    return Lifesign()


_DECODERS: dict[int, Callable[[Frame], Message]] = {
    MessageId.GENERAL: _general,
    MessageId.BREATHING: _breathing,
    MessageId.ECG: _ecg,
    MessageId.LIFESIGN: _lifesign,
    MessageId.RR: _rr,
    MessageId.ACCELERATION: _acceleration,
    MessageId.ACCELERATION_100MG: _acceleration_100mg,
    MessageId.SUMMARY: _summary,
    MessageId.EVENT: _event,
}
