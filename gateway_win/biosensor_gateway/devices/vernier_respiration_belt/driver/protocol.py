"""GDX-RB protocol: bytes in, typed messages out, and commands; no I/O and no clock.

Layouts are those of Vernier's BSD-licensed godirect-js and GDXLib; measurements are
confirmed by bytes of a real belt.
"""

from __future__ import annotations

import struct
from enum import IntEnum, unique
from typing import NamedTuple

from biosensor_gateway.devices.vernier_respiration_belt.driver.messages import (
    Measurement,
    MeasurementKind,
    Message,
    Notice,
    Reply,
    Unknown,
)
from biosensor_gateway.devices.vernier_respiration_belt.driver.packets import (
    Head,
    Packet,
    PacketParser,
)

SERVICE_UUID = "d91714ef-28b9-4f91-ba16-f0d9a604f112"
COMMAND_UUID = "f4bf14a6-c7d5-4b6d-8aa8-df1a7c83adcb"
RESPONSE_UUID = "b41e6675-a329-40e0-aa01-44d2f444babe"

_ALL_CHANNELS = 0xFF
_FROM_NOW = 0
_REPLY_PAYLOAD_AT = 6
_KIND_AT = 4


@unique
class Command(IntEnum):
    """Commands that the driver gives."""

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
    """Return the body of the command that asks what a channel measures."""
    return bytes((Command.SENSOR_INFO, channel))


def set_period(period_us: int) -> bytes:
    """Return the body of the command that sets the period of all channels."""
    return struct.pack("<BBBQ", Command.SET_PERIOD, _ALL_CHANNELS, 0, period_us)


def start(mask: int) -> bytes:
    """Return the body of the command that starts the channels of a mask, with a sample now."""
    return struct.pack("<BBBIQ", Command.START, _ALL_CHANNELS, 1, mask, _FROM_NOW)


class VernierProtocol:
    """Turns what a belt sends into messages; never raises, whatever the bytes are."""

    def __init__(self) -> None:
        self._parser = PacketParser()
        self._undecoded_bytes = 0

    @property
    def dropped_bytes(self) -> int:
        """Bytes outside of valid packets, or in packets that cannot be decoded."""
        return self._parser.dropped_bytes + self._undecoded_bytes

    @property
    def buffered(self) -> int:
        """Bytes of an incomplete packet."""
        return self._parser.buffered

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that are complete now."""
        return [self._decode(packet) for packet in self._parser.feed(data)]

    def give_up(self) -> list[Message]:
        """Drop the start of a packet whose rest will not come; return what it hid."""
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
    """Where a kind of measurement has what."""

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
