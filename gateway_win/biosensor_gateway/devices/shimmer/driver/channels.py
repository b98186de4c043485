"""The channels of a data packet, their widths, and their order in packets.

Widths, signs and byte orders are from Shimmer's firmware (log-and-stream-common).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from enum import IntEnum
from itertools import groupby
from typing import Literal, NamedTuple


class Channel(IntEnum):
    """Channels in use; a packet may contain others between them."""

    LN_ACCEL_X, LN_ACCEL_Y, LN_ACCEL_Z = 0x00, 0x01, 0x02
    WR_ACCEL_X, WR_ACCEL_Y, WR_ACCEL_Z = 0x04, 0x05, 0x06
    MAG_X, MAG_Y, MAG_Z = 0x07, 0x08, 0x09
    GYRO_X, GYRO_Y, GYRO_Z = 0x0A, 0x0B, 0x0C
    PPG = 0x12
    """Internal ADC A13, connected to the optical probe in a GSR+ unit."""
    TEMPERATURE, PRESSURE = 0x1A, 0x1B
    GSR = 0x1C
    EXG1_STATUS, EXG1_CH1_24, EXG1_CH2_24 = 0x1D, 0x1E, 0x1F
    EXG2_STATUS, EXG2_CH1_24, EXG2_CH2_24 = 0x20, 0x21, 0x22
    EXG1_CH1_16, EXG1_CH2_16 = 0x23, 0x24
    EXG2_CH1_16, EXG2_CH2_16 = 0x25, 0x26


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
_U24 = _Field(3, "little", signed=False)

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


# The older magnetometer chip, and all chips of a Shimmer3R, are big-endian.
_OLDER_MAG: dict[int, _Field] = dict.fromkeys((0x07, 0x08, 0x09), _I16_BE)
_SHIMMER3R: dict[int, _Field] = {
    **dict.fromkeys((0x0A, 0x0B, 0x0C), _I16),
    **dict.fromkeys((0x1A, 0x1B), _U24),
}


class Layout:
    """The positions of the channels' values in a data packet.

    Parameters
    ----------
    channels
        Channel ids in the order of an inquiry's answer.
    is_3r
        Whether the device is a Shimmer3R, which has different chips.

    Raises
    ------
    ValueError
        If the width of a channel is unknown.
    """

    def __init__(self, channels: Iterable[int], *, is_3r: bool = False) -> None:
        self.channels = tuple(channels)
        unknown = [channel for channel in self.channels if channel not in _FIELDS]
        if unknown:
            raise ValueError(f"channels of unknown width: {unknown}")
        fields = dict(_FIELDS)
        fields.update(_SHIMMER3R if is_3r else {})
        fields.update(_OLDER_MAG if self.has_older_mag else {})
        self._fields = [fields[channel] for channel in self.channels]
        self.size = sum(field.width for field in self._fields)
        """Total size of all values in bytes."""
        self._runs = list(_runs(self._fields))

    @property
    def has_older_mag(self) -> bool:
        """Whether the magnetometer is an LSM303DLHC, which sends its axes as X, Z, Y."""
        order = [each for each in self.channels if each in _OLDER_MAG]
        return order == [Channel.MAG_X, Channel.MAG_Z, Channel.MAG_Y]

    def index(self, channel: Channel) -> int:
        """Return the index of a channel's value in the result of `read`."""
        return self.channels.index(channel)

    def read(self, data: bytes) -> tuple[int, ...]:
        """Return the values of a packet, in packet order.

        Parameters
        ----------
        data
            The packet after its timestamp, `size` bytes.
        """
        values: list[int] = []
        for start, run in self._runs:
            if isinstance(run, _Field):
                values.append(run.read(data[start : start + run.width]))
            else:
                values += run.unpack_from(data, start)
        return tuple(values)


def _runs(fields: Sequence[_Field]) -> Iterator[tuple[int, struct.Struct | _Field]]:
    """Divide a packet into parts for `struct`, and three-byte values, which it cannot read."""
    start = 0
    for order, group in groupby(fields, key=lambda field: field.width < 3 and field.order):
        run = list(group)
        if order:
            letters = "".join(_letter(field) for field in run)
            yield start, struct.Struct(f"{'<' if order == 'little' else '>'}{letters}")
            start += sum(field.width for field in run)
        else:
            for field in run:
                yield start, field
                start += field.width


def _letter(field: _Field) -> str:
    letter = "b" if field.width == 1 else "h"
    return letter if field.signed else letter.upper()
