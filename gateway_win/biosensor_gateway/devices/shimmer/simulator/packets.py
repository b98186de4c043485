"""Data packets of each model: which channels in which order, and how each is written.

Written from the notes on Shimmer's public firmware alone, as `wire` is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from biosensor_gateway.devices.shimmer.simulator.wire import DATA, TICKS_MODULUS


class _Sensor(NamedTuple):
    mask: int
    channels: tuple[int, ...]


# In the order of the firmware, which is the order within a data packet.
_SENSORS = (
    _Sensor(0x000080, (0x00, 0x01, 0x02)),  # low-noise accelerometer
    _Sensor(0x002000, (0x03,)),  # battery
    _Sensor(0x000002, (0x0D,)),  # external A7
    _Sensor(0x000001, (0x0E,)),  # external A6
    _Sensor(0x000800, (0x0F,)),  # external A15
    _Sensor(0x000200, (0x11,)),  # internal A12
    _Sensor(0x008000, (0x27, 0x28)),  # bridge amplifier
    _Sensor(0x000100, (0x12,)),  # internal A13
    _Sensor(0x800000, (0x13,)),  # internal A14
    _Sensor(0x000004, (0x1C,)),  # skin conductance
    _Sensor(0x000400, (0x10,)),  # internal A1
    _Sensor(0x000040, (0x0A, 0x0B, 0x0C)),  # gyroscope
    _Sensor(0x001000, (0x04, 0x05, 0x06)),  # wide-range accelerometer
    _Sensor(0x000020, (0x07, 0x08, 0x09)),  # magnetometer
    _Sensor(0x400000, (0x14, 0x15, 0x16)),  # alternative accelerometer
    _Sensor(0x200000, (0x17, 0x18, 0x19)),  # alternative magnetometer
    _Sensor(0x040000, (0x1A, 0x1B)),  # temperature and pressure
    _Sensor(0x000010, (0x1D, 0x1E, 0x1F)),  # ExG 1, 24 bit
    _Sensor(0x100000, (0x1D, 0x23, 0x24)),  # ExG 1, 16 bit
    _Sensor(0x000008, (0x20, 0x21, 0x22)),  # ExG 2, 24 bit
    _Sensor(0x080000, (0x20, 0x25, 0x26)),  # ExG 2, 16 bit
)
_BRIDGE, _ANALOG_13_14 = 0x008000, 0x800100
_GSR, _ANALOG_1 = 0x000004, 0x000400
_EXG_BIG_ENDIAN = frozenset({0x1E, 0x1F, *range(0x21, 0x27)})
_BIG_ENDIAN = frozenset({*range(0x0A, 0x0D), 0x1A, 0x1B}) | _EXG_BIG_ENDIAN
_WIDTHS: Mapping[int, int] = MappingProxyType(
    {0x1B: 3, 0x1D: 1, 0x1E: 3, 0x1F: 3, 0x20: 1, 0x21: 3, 0x22: 3}
)
_MAG, _OLDER_MAG = _Sensor(0x000020, (0x07, 0x08, 0x09)), _Sensor(0x000020, (0x07, 0x09, 0x08))
# What is on the converter comes first, then what is on I2C, then on SPI.
_SENSORS_OF_3R = (
    *(each for each in _SENSORS if each.channels[0] in {0x03, *range(0x0D, 0x14), 0x1C}),
    _MAG,
    _Sensor(0x000040, (0x0A, 0x0B, 0x0C)),
    _Sensor(0x000080, (0x00, 0x01, 0x02)),
    _Sensor(0x040000, (0x1B, 0x1A)),
    _Sensor(0x400000, (0x14, 0x15, 0x16)),
    _Sensor(0x001000, (0x04, 0x05, 0x06)),
    _Sensor(0x200000, (0x17, 0x18, 0x19)),
    *(each for each in _SENSORS if each.channels[0] in {0x1D, 0x20}),
)


class Model(NamedTuple):
    """What of the wire differs between devices.

    Attributes
    ----------
    hardware
        3 for a Shimmer3, 10 for a Shimmer3R.
    sensors
        In packet order.
    big_endian
        Channels that are sent with the high byte first.
    widths
        In bytes, of channels that have not two.
    """

    hardware: int
    sensors: tuple[_Sensor, ...]
    big_endian: frozenset[int]
    widths: Mapping[int, int]


SHIMMER3 = Model(3, _SENSORS, _BIG_ENDIAN, _WIDTHS)
"""With the newer motion sensors."""
OLDER_SHIMMER3 = SHIMMER3._replace(
    sensors=tuple(_OLDER_MAG if each == _MAG else each for each in _SENSORS),
    big_endian=_BIG_ENDIAN | {0x07, 0x08, 0x09},
)
SHIMMER3R = Model(10, _SENSORS_OF_3R, _EXG_BIG_ENDIAN, MappingProxyType({**_WIDTHS, 0x1A: 3}))


def channels_of(mask: int, model: Model = SHIMMER3) -> tuple[int, ...]:
    """Return the channel ids of a sensor mask, in packet order."""
    if mask & _BRIDGE:
        mask &= ~_ANALOG_13_14
    if mask & _GSR:  # both on one input of the converter
        mask &= ~_ANALOG_1
    return tuple(
        channel for sensor in model.sensors if mask & sensor.mask for channel in sensor.channels
    )


def data_packet(
    ticks: int, channels: Iterable[int], values: Sequence[int], model: Model = SHIMMER3
) -> bytes:
    """Return a data packet without its check.

    Parameters
    ----------
    ticks
        Of 1/32768 s; the packet holds the low 24 bits.
    channels, values
        Ids as of `channels_of` and a count for each, in its width's two's complement.
    """
    body = b"".join(
        _encoded(channel, value, model) for channel, value in zip(channels, values, strict=True)
    )
    return DATA + (ticks % TICKS_MODULUS).to_bytes(3, "little") + body


def _encoded(channel: int, value: int, model: Model) -> bytes:
    width = model.widths.get(channel, 2)
    order = "big" if channel in model.big_endian else "little"
    return (value % (1 << 8 * width)).to_bytes(width, order)
