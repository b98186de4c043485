"""GDX-RB protocol: parses messages and creates commands; no I/O and no clock.

Layouts are from Vernier's BSD-licensed godirect-js and GDXLib; measurements are confirmed by data
of a real belt.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, unique
from typing import NamedTuple, TypeAlias

SERVICE_UUID = "d91714ef-28b9-4f91-ba16-f0d9a604f112"
COMMAND_UUID = "f4bf14a6-c7d5-4b6d-8aa8-df1a7c83adcb"
RESPONSE_UUID = "b41e6675-a329-40e0-aa01-44d2f444babe"

_ALL_CHANNELS = 0xFF
_FROM_NOW = 0
_REPLY_PAYLOAD_AT = 6
_KIND_AT = 4


@unique
class MeasurementKind(IntEnum):
    """Fifth byte of a measurement packet."""

    NORMAL_REAL32 = 0x06
    WIDE_REAL32 = 0x07
    SINGLE_REAL32 = 0x08
    SINGLE_INT32 = 0x09
    APERIODIC_REAL32 = 0x0A
    APERIODIC_INT32 = 0x0B
    START_TIME = 0x0C
    DROPPED = 0x0D
    PERIOD = 0x0E


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer to a command."""

    counter: int  # The device's packet counter, 0 to 255.
    command: int  # Id of the answered command.
    echo: int  # Counter of the answered command.
    payload: bytes


@dataclass(frozen=True, slots=True)
class Measurement:
    """Samples of one or more channels, oldest first."""

    counter: int  # The device's packet counter, 0 to 255.
    kind: MeasurementKind
    # By channel number, in the channel's unit; NaN is "no value". All channels have the same number
    # of samples.
    samples: Mapping[int, tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class Notice:
    """A start time, period, or notice of dropped samples, with undocumented content."""

    counter: int
    kind: MeasurementKind


@dataclass(frozen=True, slots=True)
class Unknown:
    """A packet that cannot be decoded; its bytes count as dropped."""

    counter: int


Message: TypeAlias = Reply | Measurement | Notice | Unknown

_STATUS = struct.Struct("<BBBBHBBHBB")
_DEVICE_INFO = struct.Struct("<16s16s32sHHBBBBHBBH6sI64s")
_SENSOR_INFO = struct.Struct("<bBIBB60s32sdddIQIII")
_MASK = struct.Struct("<I")

REFUSED = 0x33
"""Status bits: not recognised, ignored, and two internal errors; the others are warnings."""


@dataclass(frozen=True, slots=True)
class Status:
    """State of the belt."""

    firmware: str  # Version of the main processor, `major.minor.build`.
    ble_firmware: str  # Version of the radio.
    battery_percent: int
    charger: int  # 0 idle, 1 charging, 2 complete, 3 error.


@dataclass(frozen=True, slots=True)
class Identity:
    """The device information; texts are as printed on the belt."""

    order_code: str
    serial_number: str
    name: str
    firmware: str
    description: str


@dataclass(frozen=True, slots=True)
class Channel:
    """Description of a channel."""

    number: int
    description: str
    unit: str  # As sent by the device; may be empty.
    # min_period_us, max_period_us, granularity_us: possible sample periods.
    min_period_us: int
    max_period_us: int
    granularity_us: int


def parse_status(payload: bytes) -> Status | None:
    """Decode the reply to ``GET_STATUS``; None if it is too short."""
    if len(payload) < _STATUS.size:
        return None
    fields = _STATUS.unpack_from(payload)
    _, _, major, minor, build, ble_major, ble_minor, ble_build, battery, charger = fields
    return Status(
        f"{major}.{minor}.{build}", f"{ble_major}.{ble_minor}.{ble_build}", battery, charger
    )


def parse_device_info(payload: bytes) -> Identity | None:
    """Decode the reply to ``DEVICE_INFO``; None if it is too short."""
    if len(payload) < _DEVICE_INFO.size:
        return None
    fields = _DEVICE_INFO.unpack_from(payload)
    order_code, serial, name, description = (_text(fields[at]) for at in (0, 1, 2, -1))
    major, minor, build = fields[7:10]
    return Identity(order_code, serial, name, f"{major}.{minor}.{build}", description)


def parse_mask(payload: bytes) -> int | None:
    """Decode the reply to ``AVAILABLE_CHANNELS``, bit n for channel n; None if too short."""
    return _MASK.unpack_from(payload)[0] if len(payload) >= _MASK.size else None


def parse_channel(payload: bytes) -> Channel | None:
    """Decode the reply to ``SENSOR_INFO``; None if it is too short or there is no such channel."""
    if len(payload) < _SENSOR_INFO.size:
        return None
    fields = _SENSOR_INFO.unpack_from(payload)
    number, sensor_id = fields[0], fields[2]
    if sensor_id == 0:
        return None
    min_period, max_period, _, granularity, _ = fields[10:]
    return Channel(
        number, _text(fields[5]), _text(fields[6]), min_period, max_period, granularity
    )  # fmt: skip


def _text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("utf-8", "replace").strip()


# A packet is ``head, total length, counter, checksum, body``, and may be split into several
# notifications.
HEADER_SIZE = 4
MAX_FRAGMENT = 20
"""Size of a write that fits any MTU."""

_CHECKSUM_AT = 3


@unique
class Head(IntEnum):
    """First byte of a packet."""

    COMMAND = 0x58
    REPLY = 0x98
    MEASUREMENT = 0x20


_FROM_DEVICE = frozenset({Head.REPLY, Head.MEASUREMENT})


class Packet(NamedTuple):
    """A packet with a correct checksum."""

    head: Head
    counter: int  # The sender's counter, one byte.
    data: bytes


class PacketParser:
    """Splits a byte stream into packets, and finds the next one after damage.

    Bytes that do not begin a valid packet are dropped one by one, so the result does not depend on
    how the bytes were split. At most one packet (255 bytes) is buffered.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.dropped_bytes = 0

    @property
    def buffered(self) -> int:
        """Number of bytes of an incomplete packet."""
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
        """Discard the start of an incomplete packet; return the packets found after it."""
        packets: list[Packet] = []
        while self._buffer:
            del self._buffer[0]
            self.dropped_bytes += 1
            packets += self.feed(b"")
        return packets

    def _complete_length(self) -> int | None:
        """Return the length of the first packet; 0 if invalid, None if incomplete."""
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
    """Split a packet into pieces that fit into one write each."""
    return [packet[at : at + MAX_FRAGMENT] for at in range(0, len(packet), MAX_FRAGMENT)]


def _is_sound(packet: bytearray) -> bool:
    return packet[_CHECKSUM_AT] == _checksum(packet)


def _checksum(packet: bytearray) -> int:
    return (sum(packet) - packet[_CHECKSUM_AT]) & 0xFF


@unique
class Command(IntEnum):
    """Commands that the driver uses."""

    GET_STATUS = 0x10
    START = 0x18
    STOP = 0x19
    INIT = 0x1A
    SET_PERIOD = 0x1B
    SENSOR_INFO = 0x50
    AVAILABLE_CHANNELS = 0x51
    DISCONNECT = 0x54
    DEVICE_INFO = 0x55


INIT = bytes.fromhex("1a a54a 0649 0748 0847 0946 0a45 0b44 0c43 0d42 0e41")
GET_STATUS = bytes((Command.GET_STATUS,))
DEVICE_INFO = bytes((Command.DEVICE_INFO,))
AVAILABLE_CHANNELS = bytes((Command.AVAILABLE_CHANNELS,))
STOP = struct.pack("<BBBI", Command.STOP, _ALL_CHANNELS, 0, 0xFFFFFFFF)
DISCONNECT = bytes((Command.DISCONNECT,))


def sensor_info(channel: int) -> bytes:
    """Return the body of the command that queries a channel's description."""
    return bytes((Command.SENSOR_INFO, channel))


def set_period(period_us: int) -> bytes:
    """Return the body of the command that sets the period of all channels."""
    return struct.pack("<BBBQ", Command.SET_PERIOD, _ALL_CHANNELS, 0, period_us)


def start(mask: int) -> bytes:
    """Return the body of the command that starts the channels of a mask immediately."""
    return struct.pack("<BBBIQ", Command.START, _ALL_CHANNELS, 1, mask, _FROM_NOW)


class VernierProtocol:
    """Decodes a belt's bytes to messages; never raises, whatever the bytes."""

    def __init__(self) -> None:
        self._parser = PacketParser()
        self._undecoded_bytes = 0

    @property
    def dropped_bytes(self) -> int:
        """Number of bytes outside of valid packets or in packets that cannot be decoded."""
        return self._parser.dropped_bytes + self._undecoded_bytes

    @property
    def buffered(self) -> int:
        """Number of bytes of an incomplete packet."""
        return self._parser.buffered

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that are complete now."""
        return [self._decode(packet) for packet in self._parser.feed(data)]

    def give_up(self) -> list[Message]:
        """Discard the start of an incomplete packet; return the packets found after it."""
        return [self._decode(packet) for packet in self._parser.give_up()]

    def _decode(self, packet: Packet) -> Message:
        message = _reply(packet) if packet.head is Head.REPLY else _measurement(packet)
        if isinstance(message, Unknown):
            self._undecoded_bytes += len(packet.data)
        return message


def _reply(packet: Packet) -> Reply | Unknown:
    data = packet.data
    if len(data) < _REPLY_PAYLOAD_AT:
        return Unknown(packet.counter)
    return Reply(packet.counter, data[4], data[5], data[_REPLY_PAYLOAD_AT:])


class _Layout(NamedTuple):
    """Layout of a kind of measurement."""

    channels_format: str
    channels_at: int
    count_at: int
    data_at: int
    item: str
    is_mask: bool


_NOTICES = frozenset(
    {MeasurementKind.START_TIME, MeasurementKind.DROPPED, MeasurementKind.PERIOD}
)  # fmt: skip
_LAYOUTS = {
    MeasurementKind.NORMAL_REAL32: _Layout("<H", 5, 7, 9, "f", True),
    MeasurementKind.WIDE_REAL32: _Layout("<I", 5, 9, 11, "f", True),
    MeasurementKind.SINGLE_REAL32: _Layout("<B", 6, 7, 8, "f", False),
    MeasurementKind.SINGLE_INT32: _Layout("<B", 6, 7, 8, "i", False),
    MeasurementKind.APERIODIC_REAL32: _Layout("<B", 6, 7, 8, "f", False),
    MeasurementKind.APERIODIC_INT32: _Layout("<B", 6, 7, 8, "i", False),
}


def _measurement(packet: Packet) -> Measurement | Notice | Unknown:
    data, code = packet.data, packet.data[_KIND_AT]
    if code in _NOTICES:
        return Notice(packet.counter, MeasurementKind(code))
    if code not in _LAYOUTS:
        return Unknown(packet.counter)
    kind = MeasurementKind(code)
    layout = _LAYOUTS[kind]
    if len(data) < layout.data_at:
        return Unknown(packet.counter)
    (number,) = struct.unpack_from(layout.channels_format, data, layout.channels_at)
    channels = channels_of(number) if layout.is_mask else [number]
    items = data[layout.count_at] * len(channels)
    if len(data) != layout.data_at + 4 * items:
        return Unknown(packet.counter)
    values = struct.unpack_from(f"<{items}{layout.item}", data, layout.data_at)
    step = len(channels)
    samples = {channel: values[place::step] for place, channel in enumerate(channels)}
    return Measurement(packet.counter, kind, samples)


def channels_of(mask: int) -> list[int]:
    """Return the numbers of the channels in a mask, ascending."""
    return [channel for channel in range(mask.bit_length()) if mask >> channel & 1]
