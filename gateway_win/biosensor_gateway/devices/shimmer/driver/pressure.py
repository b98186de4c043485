"""Pressure and temperature from the sensors of a Shimmer, by the coefficients in their memory.

Formulas are those of Bosch's data sheets: BMP180 (BST-BMP180-DS000, 3.5), BMP280
(BST-BMP280-DS001, 8.1), BMP390 (BST-BMP390-DS002, 8.5 and 8.6) and BMP581 (BST-BMP581-DS004),
which compensates by itself. What the firmware does to raw values is noted where they are used.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np

from biosensor_gateway.devices.shimmer.driver.adc import Floats
from biosensor_gateway.devices.shimmer.driver.messages import PressureChip, PressureCoefficients

Compensation = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""From raw temperature and raw pressure to pressure [Pa] and temperature [degrees Celsius]."""

_DUMMY = b"\x01"
"""Firmware fills the coefficients of a chip that it has not with it."""


def are_real(coefficients: PressureCoefficients) -> bool:
    """Tell whether coefficients are those of a chip, and not the filling for none."""
    return set(coefficients.data) not in ({_DUMMY[0]}, {0x00}, {0xFF})


def compensation(coefficients: PressureCoefficients, oversampling: int) -> Compensation | None:
    """Return the compensation of a chip; None for one that is not known.

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
        # The firmware sends three registers; the last bits are below what is measured.
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
        # Of the chip's 20 bits the firmware sends the upper 16 of the temperature, and the
        # pressure with the four bits that follow.
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
    # Two's complement of 24 bits, of which the firmware makes an unsigned number.
    signed_t = np.where(raw_t >= 1 << 23, raw_t - (1 << 24), raw_t)
    return raw_p / 64, signed_t / 65536
