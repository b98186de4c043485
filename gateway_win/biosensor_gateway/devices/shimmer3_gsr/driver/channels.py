"""The channels of a data packet, their widths, and the order that a device tells.

Widths, signs and byte orders are those of Shimmer's firmware (log-and-stream-common).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import Literal, NamedTuple


class Channel(IntEnum):
    """Channels that are read out; others may stand between them in a packet."""

    PPG = 0x12
    """Internal ADC A13, to which the GSR+ unit wires the optical probe."""
    GSR = 0x1C


class _Field(NamedTuple):
    width: int
    order: Literal["little", "big"]
    signed: bool

    def read(self, data: bytes) -> int:
        return int.from_bytes(data, self.order, signed=self.signed)


_U8 = _Field(1, "little", signed=False)
_U16 = _Field(2, "little", signed=False)
_I16 = _Field(2, "little", signed=True)
_U16_BE = _Field(2, "big", signed=False)
_I16_BE = _Field(2, "big", signed=True)
_I24_BE = _Field(3, "big", signed=True)
_U24_BE = _Field(3, "big", signed=False)

_FIELDS: dict[int, _Field] = {
    **dict.fromkeys((0x00, 0x01, 0x02), _I16),  # low-noise accelerometer
    0x03: _U16,  # battery
    **dict.fromkeys((0x04, 0x05, 0x06), _I16),  # wide-range accelerometer
    **dict.fromkeys((0x07, 0x08, 0x09), _I16),  # magnetometer
    **dict.fromkeys((0x0A, 0x0B, 0x0C), _I16_BE),  # gyroscope
    **dict.fromkeys((0x0D, 0x0E, 0x0F, 0x10, 0x11, 0x12, 0x13), _U16),  # ADC inputs
    **dict.fromkeys(range(0x14, 0x1A), _I16),  # alternative accelerometer and magnetometer
    0x1A: _U16_BE,  # temperature
    0x1B: _U24_BE,  # pressure
    0x1C: _U16,  # skin conductance
    **dict.fromkeys((0x1D, 0x20), _U8),  # status of the ExG chips
    **dict.fromkeys((0x1E, 0x1F, 0x21, 0x22), _I24_BE),
    **dict.fromkeys((0x23, 0x24, 0x25, 0x26), _I16_BE),
    **dict.fromkeys((0x27, 0x28), _U16),  # bridge amplifier
}


class Layout:
    """Where each channel's value is within a data packet.

    Parameters
    ----------
    channels
        Ids in the order of an inquiry's answer.

    Raises
    ------
    ValueError
        If the width of a channel is not known.
    """

    def __init__(self, channels: Iterable[int]) -> None:
        self.channels = tuple(channels)
        unknown = [channel for channel in self.channels if channel not in _FIELDS]
        if unknown:
            raise ValueError(f"channels of unknown width: {unknown}")
        self._fields = [_FIELDS[channel] for channel in self.channels]
        self.size = sum(field.width for field in self._fields)
        """Bytes of all values."""
        self._struct = _unsigned_words(self._fields)

    def index(self, channel: Channel) -> int:
        """Position of a channel's value in what `read` returns."""
        return self.channels.index(channel)

    def read(self, data: bytes) -> tuple[int, ...]:
        """Return the values of a packet, in packet order.

        Parameters
        ----------
        data
            The packet behind its timestamp, `size` bytes.
        """
        if self._struct is not None:
            return self._struct.unpack(data)
        values: list[int] = []
        start = 0
        for field in self._fields:
            values.append(field.read(data[start : start + field.width]))
            start += field.width
        return tuple(values)


def _unsigned_words(fields: Sequence[_Field]) -> struct.Struct | None:
    """Return a fast reader for the usual packet, which has nothing but ADC values."""
    return struct.Struct(f"<{len(fields)}H") if set(fields) == {_U16} else None
