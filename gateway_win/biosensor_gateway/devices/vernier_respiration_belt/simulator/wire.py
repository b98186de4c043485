"""Packets of a Go Direct device, as it sends them.

Layouts of the BSD-licensed vendor sources: `[head, length, counter, checksum, body]`,
where the checksum is the sum of all other bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum, unique

import numpy as np
from numpy.typing import NDArray

REPLY_HEAD = 0x98
MEASUREMENT_HEAD = 0x20
COMMAND_HEAD = 0x58
HEADER_BYTES = 4
NORMAL_REAL32 = 6
_UNKNOWN_TYPE = 0x7F


@unique
class Command(IntEnum):
    """What a host may ask."""

    GET_STATUS = 0x10
    START = 0x18
    STOP = 0x19
    INIT = 0x1A
    SET_PERIOD = 0x1B
    SENSOR_INFO = 0x50
    AVAILABLE = 0x51
    DISCONNECT = 0x54
    DEVICE_INFO = 0x55
    DEFAULT = 0x56


@dataclass(frozen=True)
class Channel:
    """One sensor channel of the belt; periods in microseconds."""

    number: int
    sensor_id: int
    description: str
    unit: str
    uncertainty: float
    low: float
    high: float


CHANNELS = (
    Channel(1, 91, "Force", "N", 0.01, 0.0, 50.0),
    Channel(2, 92, "Respiration Rate", "bpm", 0.1, 0.0, 100.0),
    Channel(4, 94, "Steps", "", 1.0, 0.0, 1_000_000.0),
    Channel(5, 95, "Step Rate", "spm", 1.0, 0.0, 300.0),
)
AVAILABLE_MASK = 0x36
DEFAULT_MASK = 0x02
MIN_PERIOD_US, MAX_PERIOD_US, TYPICAL_PERIOD_US, GRANULARITY_US = 10_000, 60_000_000, 100_000, 1000


def seal(head: int, counter: int, body: bytes) -> bytes:
    """Put a header around a body."""
    packet = bytearray((head, HEADER_BYTES + len(body), counter & 0xFF, 0)) + body
    packet[3] = sum(packet) & 0xFF
    return bytes(packet)


def is_sealed(packet: bytes) -> bool:
    """Tell whether length and checksum of a packet are right."""
    return (
        len(packet) >= HEADER_BYTES + 1
        and packet[1] == len(packet)
        and (sum(packet) - packet[3]) & 0xFF == packet[3]
    )


def status(battery_percent: int) -> bytes:
    """Payload of GET_STATUS: firmware 1.7.220, radio 1.9.31, not charging."""
    return struct.pack("<BBBBHBBHBB", 0, 0, 1, 7, 220, 1, 9, 31, battery_percent, 0)


def device_info(order_code: str, serial: str) -> bytes:
    """Payload of GET_DEVICE_INFO."""
    return struct.pack(
        "<16s16s32sHHBBBBHBBH6sI64s",
        order_code.encode(),
        serial.encode(),
        f"{order_code} {serial}".encode(),
        2295,
        2020,
        3,
        17,
        1,
        7,
        220,
        1,
        9,
        31,
        bytes.fromhex("1b6a94bdf5e0"),
        256,
        b"Go Direct Respiration Belt",
    )


def sensor_info(number: int) -> bytes:
    """Payload of SENSOR_INFO; a channel that does not exist has sensor id 0."""
    channel = next((each for each in CHANNELS if each.number == number), None)
    if channel is None:
        channel = Channel(number, 0, "", "", 0.0, 0.0, 0.0)
    return struct.pack(
        "<bBIBB60s32sdddIQIII",
        channel.number,
        0,
        channel.sensor_id,
        0,
        0,
        channel.description.encode(),
        channel.unit.encode(),
        channel.uncertainty,
        channel.low,
        channel.high,
        MIN_PERIOD_US,
        MAX_PERIOD_US,
        TYPICAL_PERIOD_US,
        GRANULARITY_US,
        0,
    )


def measurements(
    mask: int, auxiliary: int, rows: NDArray[np.float32], *, known: bool = True
) -> bytes:
    """Body of a packet of samples, type NORMAL_REAL32.

    Parameters
    ----------
    mask
        Bit n is channel n.
    auxiliary
        A running byte whose meaning is not known.
    rows : ndarray of float32, shape (samples, channels)
        Channels in ascending order.
    known
        False: the type is one that no source names.
    """
    kind = NORMAL_REAL32 if known else _UNKNOWN_TYPE
    head = struct.pack("<BHBB", kind, mask, len(rows), auxiliary & 0xFF)
    return head + rows.astype("<f4").tobytes()
