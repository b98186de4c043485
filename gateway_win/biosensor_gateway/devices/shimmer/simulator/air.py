"""Pressure sensors of a virtual Shimmer: what they read, and what that stands for."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from math import pi
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.simulation.wearer import Floats, Wearer

PRESSURE, TEMPERATURE = 0x1B, 0x1A
Words = NDArray[np.int64]


class AirSensor(Protocol):
    """A pressure sensor that knows the temperature, too."""

    def raw(self, wearer: Wearer, t: Floats) -> tuple[Words, Words]:
        """Return what it reads, temperature and pressure."""
        ...

    def air(self, raw_t: int, raw_p: int) -> tuple[float, float]:
        """Return pressure [Pa] and temperature [degrees Celsius] that readings stand for."""
        ...


def _breeze(wearer: Wearer, t: Floats) -> tuple[Floats, Floats]:
    """Return slow changes of temperature and pressure, between about -1 and 1."""
    slow = np.sin(2 * pi * t / 40.0)
    return slow, 0.5 * slow + wearer.noise(t, 0.1, "air")


@dataclass(frozen=True)
class Bmp280:
    """The one of newer Shimmer3s, with the coefficients of its data sheet's example (3.12)."""

    temperature: tuple[int, int, int] = (27504, 26435, -1000)
    pressure: tuple[int, ...] = (36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000)

    @property
    def coefficients(self) -> bytes:
        """What is in it."""
        return struct.pack("<HhhH8h", *self.temperature, *self.pressure)

    def raw(self, wearer: Wearer, t: Floats) -> tuple[Words, Words]:
        """Return what it reads: the upper 16 of 20 bits, and 24 bits of which 20 count."""
        slow, quick = _breeze(wearer, t)
        raw_p = np.rint(415148 + 300 * quick) * 16
        return np.rint(32493 + 60 * slow).astype(np.int64), raw_p.astype(np.int64)

    def air(self, raw_t: int, raw_p: int) -> tuple[float, float]:
        """Return pressure and temperature by the formula in floating point (data sheet, 8.1)."""
        adc_t, adc_p = raw_t * 16.0, raw_p / 16.0
        t1, t2, t3 = self.temperature
        first = (adc_t / 16384.0 - t1 / 1024.0) * t2
        half = adc_t / 131072.0 - t1 / 8192.0
        t_fine = first + half * half * t3
        p1, p2, p3, p4, p5, p6, p7, p8, p9 = self.pressure
        a = t_fine / 2.0 - 64000.0
        b = a * a * p6 / 32768.0
        b = b + a * p5 * 2.0
        b = b / 4.0 + p4 * 65536.0
        a = (p3 * a * a / 524288.0 + p2 * a) / 524288.0
        a = (1.0 + a / 32768.0) * p1
        pascals = (1048576.0 - adc_p - b / 4096.0) * 6250.0 / a
        correction = p9 * pascals * pascals / 2147483648.0 + pascals * p8 / 32768.0 + p7
        return pascals + correction / 16.0, t_fine / 5120.0


@dataclass(frozen=True)
class Bmp180:
    """The one of older Shimmer3s, with the coefficients of its data sheet's example (3.5)."""

    words: tuple[int, ...] = (408, -72, -14383, 32741, 32757, 23153, 6190, 4, -32768, -8711, 2868)
    oversampling: int = 0

    @property
    def coefficients(self) -> bytes:
        """What is in it."""
        return struct.pack(">3h3H5h", *self.words)

    def raw(self, wearer: Wearer, t: Floats) -> tuple[Words, Words]:
        """Return what it reads: 16 bits, and 24 of which 16 and the oversampling count."""
        slow, quick = _breeze(wearer, t)
        raw_p = np.rint(23843 + 40 * quick).astype(np.int64) << (8 - self.oversampling)
        return np.rint(27898 + 30 * slow).astype(np.int64), raw_p

    def air(self, raw_t: int, raw_p: int) -> tuple[float, float]:
        """Return pressure and temperature, step by step as in the data sheet."""
        ac1, ac2, ac3, ac4, ac5, ac6, b1, b2, _, mc, md = self.words
        ut, up = float(raw_t), raw_p / (1 << (8 - self.oversampling))
        x1 = (ut - ac6) * ac5 / 32768.0
        x2 = mc * 2048.0 / (x1 + md)
        b5 = x1 + x2
        b6 = b5 - 4000.0
        x1 = b2 * (b6 * b6 / 4096.0) / 2048.0
        x2 = ac2 * b6 / 2048.0
        b3 = ((ac1 * 4.0 + x1 + x2) * (1 << self.oversampling) + 2.0) / 4.0
        x1 = ac3 * b6 / 8192.0
        x2 = b1 * (b6 * b6 / 4096.0) / 65536.0
        b4 = ac4 * ((x1 + x2 + 2.0) / 4.0 + 32768.0) / 32768.0
        b7 = (up - b3) * (50000.0 / (1 << self.oversampling))
        p = b7 * 2.0 / b4
        x1 = (p / 256.0) ** 2 * 3038.0 / 65536.0
        x2 = -7357.0 * p / 65536.0
        return p + (x1 + x2 + 3791.0) / 16.0, (b5 + 8.0) / 16.0 / 10.0


@dataclass(frozen=True)
class Bmp581:
    """One of a Shimmer3R, which says pascals and degrees by itself."""

    @property
    def coefficients(self) -> bytes:
        """What is in it: nothing that a host needs."""
        return b""

    def raw(self, wearer: Wearer, t: Floats) -> tuple[Words, Words]:
        """Return what it reads: 1/65536 degree and 1/64 Pa."""
        slow, quick = _breeze(wearer, t)
        raw_t = np.rint((31.0 + 0.4 * slow) * 65536).astype(np.int64)
        return raw_t, np.rint((100800 + 30 * quick) * 64).astype(np.int64)

    def air(self, raw_t: int, raw_p: int) -> tuple[float, float]:
        """Return pressure and temperature."""
        return raw_p / 64.0, raw_t / 65536.0
