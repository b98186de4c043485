"""The packets of an EmotiBit: comma-separated lines of text, on all channels.

A packet is ``time,number,length,tag,version,reliability`` and *length* values, and ends with
a line feed; a datagram has one or more. Source: EmotiBit_XPlat_Utils, ``EmotiBitPacket``
(MIT licence). Nothing here raises.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum, unique
from math import inf, isfinite
from typing import NamedTuple

from biosensor_common.clocks import PacketTimeline

HEADER_FIELDS = 6
NUMBERS = 2**16
"""Range of packet numbers, after which they restart."""
TIMES_MS = 2**32
"""Range of the device's milliseconds, which overflow after 49.7 days."""
PATIENCE_S = 0.5
"""Waiting time for overtaken datagrams, five rounds of sending; after that they are lost."""


@unique
class Tag(StrEnum):
    """Kinds of packets that a host uses."""

    EDA = "EA"
    PPG_INFRARED = "PI"
    PPG_RED = "PR"
    PPG_GREEN = "PG"
    TEMPERATURE_0 = "T0"
    TEMPERATURE_1 = "T1"
    THERMOPILE = "TH"
    ACC_X = "AX"
    ACC_Y = "AY"
    ACC_Z = "AZ"
    GYRO_X = "GX"
    GYRO_Y = "GY"
    GYRO_Z = "GZ"
    MAG_X = "MX"
    MAG_Y = "MY"
    MAG_Z = "MZ"
    HEART_RATE = "HR"
    INTERVAL = "BI"
    BATTERY_PERCENT = "B%"
    CLIPPING = "DC"
    OVERFLOW = "DO"
    REQUEST_DATA = "RD"
    TIMESTAMP_LOCAL = "TL"
    TIMESTAMP_UTC = "TU"
    ACK = "AK"
    MODE = "EM"
    HELLO_EMOTIBIT = "HE"
    HELLO_HOST = "HH"
    CONNECT = "EC"
    PING = "PN"
    PONG = "PO"
    DISCONNECT = "ED"
    NORMAL_POWER = "MN"


class Packet(NamedTuple):
    """One packet."""

    time_ms: int  # Device time of the last value, or of the packet if it has no values.
    number: int  # Counter of all packets of a channel, 0 to 65535.
    tag: str  # One of `Tag`, or an unused kind.
    payload: tuple[str, ...]

    def values(self) -> tuple[float, ...] | None:
        """Return the payload as numbers; None if they are not all finite numbers."""
        try:
            numbers = tuple(float(text) for text in self.payload)
        except ValueError:
            return None
        return numbers if all(map(isfinite, numbers)) else None

    def labelled(self, label: str) -> str | None:
        """Return the value after a label in a payload of labels and values."""
        pairs = dict(zip(self.payload[::2], self.payload[1::2], strict=False))
        return pairs.get(label)


class Read(NamedTuple):
    """The packets of a datagram."""

    packets: list[Packet]
    dropped_bytes: int  # Bytes of lines that are not packets.


def read(datagram: bytes) -> Read:
    """Parse the packets of a datagram."""
    packets: list[Packet] = []
    dropped = 0
    for line in datagram.split(b"\n"):
        if not line.strip(b"\r\0 "):
            continue
        packet = _packet(line)
        if packet is None:
            dropped += len(line)
        else:
            packets.append(packet)
    return Read(packets, dropped)


def write(tag: Tag, number: int, payload: Iterable[str] = (), time_ms: int = 0) -> bytes:
    """Return a packet of the host."""
    values = tuple(payload)
    header = (time_ms, number % NUMBERS, len(values), tag.value, 1, 100)
    return (",".join([*map(str, header), *values]) + "\n").encode("ascii", "replace")


def _packet(line: bytes) -> Packet | None:
    try:
        fields = line.strip(b"\r\0").decode("ascii").split(",")
        time_ms, number, length = (_natural(text) for text in fields[:3])
    except ValueError:
        return None
    # Newer firmware appends labelled values beyond the announced length; fewer mean truncation.
    if len(fields) < HEADER_FIELDS + length or number >= NUMBERS or time_ms >= TIMES_MS:
        return None
    return Packet(time_ms, number, fields[3], tuple(fields[HEADER_FIELDS:]))


def _natural(text: str) -> int:
    # int() would also accept spaces, signs, underscores and other scripts' digits.
    if not (text.isascii() and text.isdigit() and len(text) <= 10):
        raise ValueError(text)
    return int(text)


class Ordered(NamedTuple):
    """A packet in order."""

    packet: Packet
    time_s: float  # Unwrapped device time.
    is_behind_gap: bool  # Whether packets before it were lost.


class _Waiting(NamedTuple):
    """A packet that overtook others, and the newest device time at its arrival."""

    packet: Packet
    time_s: float
    since_s: float


class InOrder:
    """Returns packets in the order of their numbers, without repetitions.

    Datagrams may overtake each other, so packets after a missing number wait for it.
    """

    def __init__(self) -> None:
        self.left_out = 0  # Number of packets that came twice, or after they were counted as lost.
        self._numbers = PacketTimeline(NUMBERS)
        self._waiting: dict[int, _Waiting] = {}
        self._newest_s = self._handed_out_s = -inf
        self._first: tuple[int, float] | None = None
        self._early: set[int] = set()

    def take(self, packet: Packet, time_s: float) -> list[Ordered]:
        """Add a packet; return those in order now, without repetitions."""
        steps = self._numbers.steps(packet.number, least=None)
        if steps is None:
            self._first = packet.number, time_s
            return [self._hand_out(packet, time_s, is_behind_gap=False)]
        place = (self._numbers.newest or 0) + steps
        ready: list[Ordered] = []
        if steps <= 0:
            if time_s <= self._handed_out_s:
                return self._late(Ordered(packet, time_s, is_behind_gap=False), place)
            # The device restarted its numbers.
            ready = [*self.end(), self._hand_out(packet, time_s, is_behind_gap=True)]
        else:
            self._newest_s = max(self._newest_s, time_s)
            waiting = _Waiting(packet, time_s, self._newest_s)
            self.left_out += self._waiting.setdefault(place, waiting) is not waiting
        while self._waiting and self._is_ripe(min(self._waiting)):
            ready.append(self._hand_out_first())
        return ready

    def end(self) -> list[Ordered]:
        """Return the waiting packets, and restart with the next packet."""
        ready = [self._hand_out_first() for _ in range(len(self._waiting))]
        self._numbers.forget()
        self._newest_s = self._handed_out_s = -inf
        self._first = None
        self._early.clear()
        return ready

    def _late(self, packet: Ordered, place: int) -> list[Ordered]:
        """Return a packet that the very first one overtook."""
        # Other late packets are repetitions, or arrive after they were counted as lost.
        first, first_s = self._first or (place, packet.time_s)
        if place >= first or place in self._early or self._newest_s > first_s + PATIENCE_S:
            self.left_out += 1
            return []
        self._early.add(place)
        return [packet]

    def _is_ripe(self, place: int) -> bool:
        is_next = place == (self._numbers.newest or 0) + 1
        return is_next or self._newest_s - self._waiting[place].since_s > PATIENCE_S

    def _hand_out_first(self) -> Ordered:
        place = min(self._waiting)
        first = self._waiting.pop(place)
        is_behind_gap = place != (self._numbers.newest or 0) + 1
        return self._hand_out(first.packet, first.time_s, is_behind_gap=is_behind_gap)

    def _hand_out(self, packet: Packet, time_s: float, *, is_behind_gap: bool) -> Ordered:
        self._numbers.place(packet.number)
        self._handed_out_s = max(self._handed_out_s, time_s)
        self._newest_s = max(self._newest_s, time_s)
        return Ordered(packet, time_s, is_behind_gap)
