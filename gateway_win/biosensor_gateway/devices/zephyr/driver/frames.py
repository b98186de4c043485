"""Framing of the BioHarness serial protocol; what a frame means is in ``protocol``.

Layout: ``02 | id | n | payload (n bytes) | crc | end``. The CRC is CRC-8 with
reflected polynomial 0x8C over the payload only, so the length is checked
against the id as well: without that, one flipped bit turns one kind of packet
into another about three times in a hundred.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

STX = 0x02
MAX_PAYLOAD = 128
_OVERHEAD = 5
# Larger input is taken in slices, so the buffer stays small whatever arrives.
_SLICE = 1024


class Terminator(IntEnum):
    """Last byte of a frame; old firmware ends periodic packets with ACK too."""

    ETX = 0x03
    ACK = 0x06
    NAK = 0x15


_TERMINATORS = {int(end): end for end in Terminator}


class MessageId(IntEnum):
    """Messages that the device sends by itself."""

    GENERAL = 0x20
    BREATHING = 0x21
    ECG = 0x22
    LIFESIGN = 0x23
    RR = 0x24
    ACCELERATION = 0x25
    ACCELERATION_100MG = 0x2A
    SUMMARY = 0x2B
    EVENT = 0x2C


HXM = 0x26
"""What a Zephyr HxM sends once a second: a strap that knows no request."""

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
    """CRC-8 of a payload; 0 for an empty one."""
    crc = 0
    for byte in payload:
        crc = _CRC[crc ^ byte]
    return crc


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame whose length, CRC and end were right."""

    message_id: int
    payload: bytes
    terminator: Terminator


def request(message_id: int, payload: bytes = b"") -> bytes:
    """Bytes of a request from the host."""
    return bytes((STX, message_id, len(payload), *payload, crc8(payload), Terminator.ETX))


class FrameParser:
    """Cuts a byte stream into frames; bytes that belong to none are dropped and counted.

    On a rejected frame one byte is dropped and the search goes on behind it,
    because 02 is a legal byte inside a payload.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.dropped_bytes = 0

    @property
    def buffered(self) -> int:
        """Number of bytes held back as the possible start of a frame."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Frame]:
        """Take the next bytes, in pieces of any size; return the frames that they complete."""
        frames: list[Frame] = []
        for start in range(0, len(data), _SLICE):
            self._buffer += data[start : start + _SLICE]
            self._scan(frames)
        return frames

    def give_up(self) -> list[Frame]:
        """Stop waiting for the rest of a frame; return what was hidden behind its first byte."""
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
        """Size of the frame at *start*: 0 if there can be none, None if more bytes must come."""
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
