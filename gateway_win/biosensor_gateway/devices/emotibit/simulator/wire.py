"""Writes an EmotiBit's packets, and reads a host's.

Source: EmotiBit_XPlat_Utils, ``EmotiBitPacket`` (MIT licence).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

LONGEST_DATAGRAM = 512
HELLO, HERE, CONNECT, PING, PONG = "HE", "HH", "EC", "PN", "PO"
DISCONNECT, NORMAL_POWER = "ED", "MN"
QUIET = frozenset({"ML", "MM"})
"""Modes of low power, in which it is there and sends no data."""
REQUEST, TIME_LOCAL, TIME_UTC, ACKNOWLEDGED = "RD", "TL", "TU", "AK"


class Message(NamedTuple):
    """A packet of a host."""

    tag: str
    payload: tuple[str, ...]

    def behind(self, label: str) -> int | None:
        """Return the number behind a label of the payload."""
        if label not in self.payload[:-1]:
            return None
        return int(self.payload[self.payload.index(label) + 1])


def packet(time_ms: int, number: int, tag: str, payload: Sequence[str], version: int = 1) -> bytes:
    """Write a packet, with its line feed."""
    header = f"{time_ms},{number % 65536},{len(payload)},{tag},{version},100"
    return ",".join([header, *payload]).encode("ascii") + b"\n"


def heard(line: bytes) -> Message:
    """Read a host's packet, without its line feed."""
    fields = line.decode("ascii").strip().split(",")
    return Message(fields[3], tuple(fields[6:]))


def datagrams(packets: Sequence[bytes]) -> list[list[bytes]]:
    """Pack whole packets into datagrams that are not too long."""
    packed: list[list[bytes]] = [[]]
    for each in packets:
        if packed[-1] and sum(map(len, packed[-1])) + len(each) > LONGEST_DATAGRAM:
            packed.append([])
        packed[-1].append(each)
    return [each for each in packed if each]
