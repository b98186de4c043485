"""Assigns channels to streams, and converts their values to units."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from biosensor_gateway.devices.shimmer.driver.calibration import (
    STANDARD_GRAVITY_MS2,
    Block,
    Exg,
    Floats,
    Kinematic,
    Use,
    microvolts,
)
from biosensor_gateway.devices.shimmer.driver.channels import Channel, Layout
from biosensor_gateway.devices.shimmer.driver.messages import PressureChip, PressureCoefficients

Compensation = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""Converts raw temperature and raw pressure to pressure [Pa] and temperature [Celsius]."""

# Firmware fills the coefficients of a missing chip with this byte.
_DUMMY = b"\x01"


class Sensor(NamedTuple):
    """A sensor that can be switched on."""

    mask: int
    channels: frozenset[Channel]  # Its channels in each packet.


class Motion(NamedTuple):
    """A three-axis motion sensor."""

    mask: int
    axes: tuple[Channel, Channel, Channel]  # Channels of X, Y, Z.
    block: Block  # Index of its calibration.
    units: float = 1.0  # Number of calibration units per unit of the stream.


MOTION = {
    "acc_low_noise": Motion(
        0x000080,
        (Channel.LN_ACCEL_X, Channel.LN_ACCEL_Y, Channel.LN_ACCEL_Z),
        Block.LN_ACCEL,
        STANDARD_GRAVITY_MS2,
    ),
    "acc_wide_range": Motion(
        0x001000,
        (Channel.WR_ACCEL_X, Channel.WR_ACCEL_Y, Channel.WR_ACCEL_Z),
        Block.WR_ACCEL,
        STANDARD_GRAVITY_MS2,
    ),
    "gyro": Motion(0x000040, (Channel.GYRO_X, Channel.GYRO_Y, Channel.GYRO_Z), Block.GYRO),
    "mag": Motion(0x000020, (Channel.MAG_X, Channel.MAG_Y, Channel.MAG_Z), Block.MAG),
}
_AIR = (Channel.TEMPERATURE, Channel.PRESSURE)
_EXG = {
    24: (
        (Channel.EXG1_STATUS, Channel.EXG1_CH1_24, Channel.EXG1_CH2_24),
        (Channel.EXG2_STATUS, Channel.EXG2_CH1_24, Channel.EXG2_CH2_24),
    ),
    16: (
        (Channel.EXG1_STATUS, Channel.EXG1_CH1_16, Channel.EXG1_CH2_16),
        (Channel.EXG2_STATUS, Channel.EXG2_CH1_16, Channel.EXG2_CH2_16),
    ),
}
_EXG_MASKS = {24: (0x000010, 0x000008), 16: (0x100000, 0x080000)}
SENSORS = (*MOTION, "pressure", *Use)
"""Names of the sensors, which are the data names of their (first) streams."""


def sensor(name: str, bits: int) -> Sensor:
    """Return a sensor of `SENSORS`, an ExG with 16 or 24 bits."""
    if name in MOTION:
        return Sensor(MOTION[name].mask, frozenset(MOTION[name].axes))
    if name == "pressure":
        return Sensor(0x040000, frozenset(_AIR))
    # EMG only needs one of the two chips.
    chips = 2 if name == Use.ECG else 1
    on = [each for chip in _EXG[bits][:chips] for each in chip]
    return Sensor(sum(_EXG_MASKS[bits][:chips]), frozenset(on))


@dataclass(frozen=True, slots=True)
class Signal:
    """A stream with a sample in each packet."""

    data_name: str
    at: tuple[int, ...]  # Positions of its channels in a packet.
    # Converts their values, shape (n, channels), to samples of the stream.
    convert: Callable[[Floats], Floats]


def motion_on(layout: Layout) -> list[str]:
    """Return the data names of the motion sensors in packets."""
    return [name for name, each in MOTION.items() if set(each.axes) <= set(layout.channels)]


def has_air(layout: Layout) -> bool:
    """Whether packets contain pressure and temperature."""
    return set(_AIR) <= set(layout.channels)


def has_exg(layout: Layout) -> bool:
    """Whether packets contain values of the first ExG chip."""
    return _bits(layout, chip=0) is not None


def motion_signals(layout: Layout, calibrations: Iterable[tuple[str, Kinematic]]) -> list[Signal]:
    """Return the streams of motion sensors with these calibrations."""

    def convert(calibration: Kinematic, units: float, raw: Floats) -> Floats:
        return calibration.apply(raw) / units

    return [
        Signal(name, _places(layout, each.axes), partial(convert, calibration, each.units))
        for name, calibration in calibrations
        for each in [MOTION[name]]
    ]


def air_signals(layout: Layout, compensate: Compensation) -> list[Signal]:
    """Return the streams of pressure and temperature."""
    at = _places(layout, _AIR)
    return [
        Signal("pressure", at, lambda raw: compensate(raw[:, 0], raw[:, 1])[0]),
        Signal("temp", at, lambda raw: compensate(raw[:, 0], raw[:, 1])[1]),
    ]


def exg_signal(layout: Layout, exg: Exg) -> Signal:
    """Return the stream of the ExG chips; leads of a disabled chip are NaN."""
    leads = [(0, 1), (0, 2)] if exg.use is Use.EMG else [(0, 1), (0, 2), (1, 2)]
    scales: list[float] = []
    at: list[int] = []
    for chip, channel in leads:
        bits = _bits(layout, chip)
        found = _EXG[bits or 24][chip][channel]
        at.append(layout.index(found) if bits else layout.index(Channel.EXG1_STATUS))
        scales.append(float(microvolts(1, exg.gain(chip, channel), bits)) if bits else np.nan)
    return Signal(exg.use, tuple(at), lambda raw: raw * np.array(scales))


def status_places(layout: Layout) -> tuple[int, int] | None:
    """Return the positions of both chips' status; None if one chip is off."""
    wanted = (Channel.EXG1_STATUS, Channel.EXG2_STATUS)
    if not set(wanted) <= set(layout.channels):
        return None
    first, second = _places(layout, wanted)
    return first, second


def _bits(layout: Layout, chip: int) -> int | None:
    for bits, chips in _EXG.items():
        if set(chips[chip]) <= set(layout.channels):
            return bits
    return None


def _places(layout: Layout, channels: Sequence[Channel]) -> tuple[int, ...]:
    return tuple(layout.index(each) for each in channels)


def are_real(coefficients: PressureCoefficients) -> bool:
    """Whether coefficients belong to a chip and are not filler bytes."""
    return set(coefficients.data) not in ({_DUMMY[0]}, {0x00}, {0xFF})


def compensation(coefficients: PressureCoefficients, oversampling: int) -> Compensation | None:
    """Return the compensation of a chip; None if the chip is unknown.

    Parameters
    ----------
    oversampling
        Setting of a BMP180, 0 to 3.
    """
    data = coefficients.data
    match coefficients.chip:
        case PressureChip.BMP180 if len(data) == _BMP180.size:
            return _bmp180(data, oversampling)
        case PressureChip.BMP280 if len(data) == _BMP280.size:
            return _bmp280(data)
        case PressureChip.BMP390 if len(data) == _BMP390.size:
            return _bmp390(data)
        case PressureChip.BMP581:
            return _bmp581
        case _:
            return None


_BMP180 = struct.Struct(">3h3H5h")
_BMP280 = struct.Struct("<HhhH8h")
_BMP390 = struct.Struct("<HHbhhbbHHbbhbb")


def _bmp180(data: bytes, oversampling: int) -> Compensation:
    ac1, ac2, ac3, ac4, ac5, ac6, b1, b2, _, mc, md = _BMP180.unpack(data)

    def compensate(raw_t: Floats, raw_p: Floats) -> tuple[Floats, Floats]:
        # The firmware sends three registers, whose lowest bits are beyond the resolution.
        raw_p = raw_p / 2.0 ** (8 - oversampling)
        x1 = (raw_t - ac6) * ac5 / 2**15
        b5 = x1 + mc * 2**11 / (x1 + md)
        b6 = b5 - 4000
        x3 = b2 * b6 * b6 / 2**23 + ac2 * b6 / 2**11
        b3 = ((ac1 * 4 + x3) * 2**oversampling + 2) / 4
        x3 = (ac3 * b6 / 2**13 + b1 * b6 * b6 / 2**28 + 2) / 4
        b4 = ac4 * (x3 + 2**15) / 2**15
        p = (raw_p - b3) * (50000 / 2**oversampling) * 2 / b4
        x1 = (p / 2**8) ** 2 * 3038 / 2**16
        return p + (x1 - 7357 * p / 2**16 + 3791) / 16, (b5 + 8) / 160

    return compensate


def _bmp280(data: bytes) -> Compensation:
    t1, t2, t3, p1, p2, p3, p4, p5, p6, p7, p8, p9 = _BMP280.unpack(data)

    def compensate(raw_t: Floats, raw_p: Floats) -> tuple[Floats, Floats]:
        # The chip has 20 bits. The firmware sends the upper 16 bits of the temperature, and 24
        # bits of the pressure including the four bits after it.
        raw_t, raw_p = raw_t * 16, raw_p / 16
        fine = (raw_t / 16384 - t1 / 1024) * t2 + (raw_t / 131072 - t1 / 8192) ** 2 * t3
        v1 = fine / 2 - 64000
        v2 = (v1 * v1 * p6 / 32768 + v1 * p5 * 2) / 4 + p4 * 65536
        v1 = (1 + (p3 * v1 * v1 / 524288 + p2 * v1) / 524288 / 32768) * p1
        p = (1048576 - raw_p - v2 / 4096) * 6250 / v1
        p = p + (p9 * p * p / 2147483648 + p * p8 / 32768 + p7) / 16
        return p, fine / 5120

    return compensate


_BMP390_EXPONENTS = (-8, 30, 48, 20, 29, 32, 37, -3, 6, 8, 15, 48, 48, 65)
_BMP390_OFFSETS = (0, 0, 0, 16384, 16384, 0, 0, 0, 0, 0, 0, 0, 0, 0)


def _bmp390(data: bytes) -> Compensation:
    numbers = zip(_BMP390.unpack(data), _BMP390_OFFSETS, _BMP390_EXPONENTS, strict=True)
    scaled = [(value - offset) / 2.0**exponent for value, offset, exponent in numbers]
    t1, t2, t3, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11 = scaled

    def compensate(raw_t: Floats, raw_p: Floats) -> tuple[Floats, Floats]:
        from_zero = raw_t - t1
        t = from_zero * t2 + from_zero**2 * t3
        base = p5 + p6 * t + p7 * t**2 + p8 * t**3
        linear = raw_p * (p1 + p2 * t + p3 * t**2 + p4 * t**3)
        return base + linear + raw_p**2 * (p9 + p10 * t) + raw_p**3 * p11, t

    return compensate


def _bmp581(raw_t: Floats, raw_p: Floats) -> tuple[Floats, Floats]:
    # 24-bit two's complement, which the firmware sends as an unsigned number.
    signed_t = np.where(raw_t >= 1 << 23, raw_t - (1 << 24), raw_t)
    return raw_p / 64, signed_t / 65536
