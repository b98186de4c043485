"""Packets of Go Direct devices: ``head, total length, counter, checksum, body``.

The layout is that of Vernier's BSD-licensed godirect-js and GDXLib. A packet comes
in as many notifications as the connection makes of it.
"""

from __future__ import annotations

from enum import IntEnum, unique
from typing import NamedTuple

HEADER_SIZE = 4
MAX_FRAGMENT = 20
"""What fits into a write whatever the connection's MTU."""

_CHECKSUM_AT = 3


@unique
class Head(IntEnum):
    """First byte of a packet."""

    COMMAND = 0x58
    REPLY = 0x98
    MEASUREMENT = 0x20


_FROM_DEVICE = frozenset({Head.REPLY, Head.MEASUREMENT})


class Packet(NamedTuple):
    """A packet whose checksum is right.

    Attributes
    ----------
    head
    counter
        The sender's own, one byte.
    data
        The whole packet.
    """

    head: Head
    counter: int
    data: bytes


class PacketParser:
    """Cuts a byte stream into packets, and finds the next one after damage.

    Bytes that begin no valid packet are dropped one by one, so the result does not
    depend on how the bytes were cut. At most one packet (255 bytes) is kept.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.dropped_bytes = 0

    @property
    def buffered(self) -> int:
        """Bytes of an incomplete packet."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets that are complete now."""
        self._buffer += data
        packets: list[Packet] = []
        while self._buffer:
            length = self._complete_length()
            if length is None:
                break
            if length == 0 or not _is_sound(self._buffer[:length]):
                del self._buffer[0]
                self.dropped_bytes += 1
                continue
            packet = bytes(self._buffer[:length])
            del self._buffer[:length]
            packets.append(Packet(Head(packet[0]), packet[2], packet))
        return packets

    def give_up(self) -> list[Packet]:
        """Drop the start of a packet whose rest will not come; return what it hid."""
        packets: list[Packet] = []
        while self._buffer:
            del self._buffer[0]
            self.dropped_bytes += 1
            packets += self.feed(b"")
        return packets

    def _complete_length(self) -> int | None:
        """Return the length of the first packet, 0 if there is none, None if bytes are missing."""
        if self._buffer[0] not in _FROM_DEVICE:
            return 0
        if len(self._buffer) < 2:
            return None
        length = self._buffer[1]
        if length <= HEADER_SIZE:
            return 0
        return length if len(self._buffer) >= length else None


def encode(counter: int, body: bytes) -> bytes:
    """Return a command packet.

    Raises
    ------
    ValueError
        If the counter or the length does not fit into a byte.
    """
    packet = bytearray((Head.COMMAND, HEADER_SIZE + len(body), counter, 0)) + body
    packet[_CHECKSUM_AT] = _checksum(packet)
    return bytes(packet)


def fragments(packet: bytes) -> list[bytes]:
    """Return a packet in pieces that fit into one write each."""
    return [packet[at : at + MAX_FRAGMENT] for at in range(0, len(packet), MAX_FRAGMENT)]


def _is_sound(packet: bytearray) -> bool:
    return packet[_CHECKSUM_AT] == _checksum(packet)


def _checksum(packet: bytearray) -> int:
    return (sum(packet) - packet[_CHECKSUM_AT]) & 0xFF
