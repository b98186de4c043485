"""The packets of an EmotiBit: lines of text with commas, on all of its channels.

A packet is ``time,number,length,tag,version,reliability`` and *length* values, and ends with
a line feed; a datagram has one or more. Source: EmotiBit_XPlat_Utils, ``EmotiBitPacket``
(MIT licence). Nothing here raises.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum, unique
from math import isfinite
from typing import NamedTuple

HEADER_FIELDS = 6
NUMBERS = 2**16
"""The packets' numbers begin anew after so many."""
TIMES_MS = 2**32
"""The device's milliseconds begin anew after so many, 49.7 days."""


@unique
class Tag(StrEnum):
    """What a packet holds; those that a host has use for."""

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
    """One packet.

    Attributes
    ----------
    time_ms
        Device's clock: of the last value, where there are values.
    number
        Counts all packets of a channel, 0 to 65535.
    tag
        One of `Tag`, or what this driver has no use for.
    payload
    """

    time_ms: int
    number: int
    tag: str
    payload: tuple[str, ...]

    def values(self) -> tuple[float, ...] | None:
        """Return the payload as finite numbers; None if it is something else."""
        try:
            numbers = tuple(float(text) for text in self.payload)
        except ValueError:
            return None
        return numbers if all(map(isfinite, numbers)) else None

    def labelled(self, label: str) -> str | None:
        """Return what stands behind a label in a payload of labels and values."""
        pairs = dict(zip(self.payload[::2], self.payload[1::2], strict=False))
        return pairs.get(label)


class Read(NamedTuple):
    """What a datagram holds.

    Attributes
    ----------
    packets
    dropped_bytes
        Of lines that are no packet.
    """

    packets: list[Packet]
    dropped_bytes: int


def read(datagram: bytes) -> Read:
    """Read the packets of a datagram."""
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
    """Write a packet of the host."""
    values = tuple(payload)
    header = (time_ms, number % NUMBERS, len(values), tag.value, 1, 100)
    return (",".join([*map(str, header), *values]) + "\n").encode("ascii", "replace")


def _packet(line: bytes) -> Packet | None:
    try:
        fields = line.strip(b"\r\0").decode("ascii").split(",")
        time_ms, number, length = (_natural(text) for text in fields[:3])
    except ValueError:
        return None
    # Newer firmware says more than it announces, with labels; less is a packet that was cut.
    if len(fields) < HEADER_FIELDS + length or number >= NUMBERS or time_ms >= TIMES_MS:
        return None
    return Packet(time_ms, number, fields[3], tuple(fields[HEADER_FIELDS:]))


def _natural(text: str) -> int:
    # int() takes spaces, signs, underscores and other scripts' digits as well.
    if not (text.isascii() and text.isdigit() and len(text) <= 10):
        raise ValueError(text)
    return int(text)
