"""Encodes the packets of a Go Direct device.

Layouts are from the vendor's BSD-licensed sources: `[head, length, counter, checksum, body]`,
where the checksum is the sum of all other bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
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
    """Commands of a host."""

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
    """Return a packet with this body."""
    packet = bytearray((head, HEADER_BYTES + len(body), counter & 0xFF, 0)) + body
    packet[3] = sum(packet) & 0xFF
    return bytes(packet)


def is_sealed(packet: bytes) -> bool:
    """Whether length and checksum of a packet are correct."""
    return (
        len(packet) >= HEADER_BYTES + 1
        and packet[1] == len(packet)
        and (sum(packet) - packet[3]) & 0xFF == packet[3]
    )


def status(battery_percent: int) -> bytes:
    """Return the payload of GET_STATUS: firmware 1.7.220, radio 1.9.31, not charging."""
    return struct.pack("<BBBBHBBHBB", 0, 0, 1, 7, 220, 1, 9, 31, battery_percent, 0)


def device_info(order_code: str, serial: str) -> bytes:
    """Return the payload of GET_DEVICE_INFO."""
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
    """Return the payload of SENSOR_INFO; a missing channel has sensor id 0."""
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
    """Return the body of a packet of samples, type NORMAL_REAL32.

    Parameters
    ----------
    mask
        Bit n is channel n.
    auxiliary
        A counting byte with unknown meaning.
    rows : ndarray of float32, shape (samples, channels)
        Channels in ascending order.
    known
        If False, the type is undocumented.
    """
    kind = NORMAL_REAL32 if known else _UNKNOWN_TYPE
    head = struct.pack("<BHBB", kind, mask, len(rows), auxiliary & 0xFF)
    return head + rows.astype("<f4").tobytes()


_ACCEPTED, _NOT_RECOGNISED, _IGNORED = b"\x00", b"\x01", b"\x02"
_DEFAULT_PERIOD_US = TYPICAL_PERIOD_US


class BeltFirmware:
    """Executes commands and encodes packets, over all connections.

    Parameters
    ----------
    order_code, serial
        Contents of the device information.

    Attributes
    ----------
    mask
        Measured channels; 0 while stopped.
    """

    def __init__(self, order_code: str, serial: str) -> None:
        self._order_code = order_code
        self._serial = serial
        self.battery_percent = 76
        self.refuses = False  # Whether every command is answered with the status "ignored".
        self.knows_type = True  # If False, samples have an undocumented type.
        self.starts = 0
        self.forget()

    def forget(self) -> None:
        """Reset all modes and counters, as at the end of a connection."""
        self.mask = 0
        self.period_us = _DEFAULT_PERIOD_US
        self._counter = 0
        self._auxiliary = 0
        self._heard = bytearray()

    def hear(self, fragment: bytes) -> list[bytes]:
        """Add a piece of a command; return the answer packets."""
        self._heard += fragment
        answers: list[bytes] = []
        while len(self._heard) >= HEADER_BYTES + 1:
            length = self._heard[1]
            if self._heard[0] != COMMAND_HEAD or length < HEADER_BYTES + 1:
                self._heard.clear()
                break
            if len(self._heard) < length:
                break
            command = bytes(self._heard[:length])
            del self._heard[:length]
            if is_sealed(command):
                answers.append(self._answer(command))
        return answers

    def pack(self, rows: NDArray[np.float32]) -> bytes:
        """Return a packet with the next samples of the measured channels."""
        body = measurements(self.mask, self._auxiliary, rows, known=self.knows_type)
        self._auxiliary += len(rows)
        return self._seal(MEASUREMENT_HEAD, body)

    def _answer(self, command: bytes) -> bytes:
        number = command[4]
        payload = _IGNORED if self.refuses else self._carry_out(number, command[5:])
        return self._seal(REPLY_HEAD, bytes((number, command[2])) + payload)

    def _carry_out(self, number: int, arguments: bytes) -> bytes:
        match number:
            case Command.SENSOR_INFO if arguments:
                return sensor_info(arguments[0])
            case Command.SET_PERIOD if len(arguments) >= 10:
                return self._set_period(struct.unpack_from("<Q", arguments, 2)[0])
            case Command.START if len(arguments) >= 6:
                return self._start(struct.unpack_from("<I", arguments, 2)[0])
            case Command.STOP:
                self.mask = 0
                return _ACCEPTED
            case _:
                return self._told().get(number, _NOT_RECOGNISED)

    def _told(self) -> Mapping[int, bytes]:
        """Return the answers to queries."""
        return {
            Command.INIT: _ACCEPTED,
            Command.DISCONNECT: _ACCEPTED,
            Command.GET_STATUS: status(self.battery_percent),
            Command.DEVICE_INFO: device_info(self._order_code, self._serial),
            Command.AVAILABLE: struct.pack("<I", AVAILABLE_MASK),
            Command.DEFAULT: struct.pack("<I", DEFAULT_MASK),
        }

    def _set_period(self, period_us: int) -> bytes:
        is_possible = MIN_PERIOD_US <= period_us <= MAX_PERIOD_US
        if not is_possible or period_us % GRANULARITY_US:
            return _IGNORED
        self.period_us = period_us
        return _ACCEPTED

    def _start(self, mask: int) -> bytes:
        if not mask or mask & ~AVAILABLE_MASK:
            return _IGNORED
        self.mask = mask
        self.starts += 1
        return _ACCEPTED

    def _seal(self, head: int, body: bytes) -> bytes:
        packet = seal(head, self._counter, body)
        self._counter += 1
        return packet
