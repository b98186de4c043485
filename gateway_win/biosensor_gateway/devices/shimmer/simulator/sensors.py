"""The sensors of a virtual Shimmer: ExG chips, air pressure and motion.

Each converts physical quantities to counts and back.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.simulation.wearer import Floats, Wearer

Triple = tuple[float, float, float]
Words = NDArray[np.int64]

GRAVITY_MS2 = 9.80665
LN_ACCEL, WR_ACCEL = (0x00, 0x01, 0x02), (0x04, 0x05, 0x06)
MAG, GYRO = (0x07, 0x08, 0x09), (0x0A, 0x0B, 0x0C)
UNWRITTEN = b"\xff" * 21

STATUS = (0x1D, 0x20)
CHANNELS_24 = ((0x1E, 0x1F), (0x21, 0x22))
CHANNELS_16 = ((0x23, 0x24), (0x25, 0x26))
# The vendor's usual registers, with direct-current lead-off detection for the ECG.
ECG_WITH_LEAD_OFF = (
    bytes((0x01, 0xE0, 0x54, 0x40, 0x40, 0x3D, 0x07, 0x00, 0x02, 0x03)),
    bytes((0x01, 0xE0, 0x54, 0x40, 0x47, 0x00, 0x04, 0x00, 0x02, 0x01)),
)
EMG = (
    bytes((0x01, 0xA0, 0x10, 0x69, 0x60, 0x20, 0x00, 0x00, 0x02, 0x03)),
    bytes((0x01, 0xA0, 0x10, 0xE1, 0xE1, 0x00, 0x00, 0x00, 0x02, 0x01)),
)
MASKS_24, MASKS_16 = (0x10, 0x08), (0x100000, 0x080000)

_REFERENCE_V = 2.42
_GAINS = (6, 1, 2, 3, 4, 8, 12)
_COMPARATORS = 0x40
_FRESH = 0x80
_ROUTED_FROM_CHANNEL_3 = 9
# Voltage of an open input, which the lead-off current drives to its limit.
_RAIL_MV = 350.0


@dataclass(frozen=True)
class ExgChips:
    """Both chips while they measure."""

    registers: Sequence[bytes]  # Ten registers of each chip.

    @property
    def is_emg(self) -> bool:
        """Whether channel 1 of chip 1 is routed to its third channel."""
        return self.registers[0][3] & 0x0F == _ROUTED_FROM_CHANNEL_3

    @property
    def detects(self) -> bool:
        """Whether the lead-off comparators of both chips are on."""
        return all(each[1] & _COMPARATORS for each in self.registers)

    def status(self, chip: int, *, worn: bool) -> int:
        """Return the status byte with the open inputs."""
        return _FRESH | (0 if worn or not self.detects else self.registers[chip][6] & 0x0F)

    def count_v(self, chip: int, channel: int) -> float:
        """Return the voltage of one 24-bit count, channel 0 or 1."""
        gain = _GAINS[self.registers[chip][3 + channel] >> 4 & 7]
        return _REFERENCE_V / gain / ((1 << 23) - 1)

    def counts(self, chip: int, channel: int, microvolts: Floats, bits: int) -> Words:
        """Return the counts of a voltage; with 16 bits, those below the highest of 24 bits."""
        counts = np.rint(microvolts * 1e-6 / self.count_v(chip, channel)).astype(np.int64)
        if bits == 16:
            counts >>= 7
        highest = (1 << (bits - 1)) - 1
        return np.clip(counts, -highest - 1, highest)

    def microvolts(self, chip: int, channel: int, counts: Words, bits: int) -> Floats:
        """Return the voltage of counts, as in the vendor's programs."""
        volts: Floats = counts.astype(np.float64) * self.count_v(chip, channel)
        if bits == 16:
            volts = volts * ((1 << 23) - 1) / (2 * ((1 << 15) - 1))
        return volts * 1e6


def voltages(wearer: Wearer, t: Floats, *, is_emg: bool, worn: bool) -> tuple[Floats, ...]:
    """Return the voltages at both channels of both chips [uV]."""
    if not worn:
        railed = np.full(t.shape, 1000 * _RAIL_MV)
        return railed, railed, railed, railed
    silence = np.zeros(t.shape)
    if is_emg:
        effort = np.maximum(0.0, np.sin(2 * pi * t / 5.0)) ** 2
        first = (5 + 180 * effort) * wearer.noise(t, 1.0, "biceps")
        return first, (5 + 90 * effort) * wearer.noise(t, 1.0, "triceps"), silence, silence
    lead_ii = wearer.ecg_uv(t)
    return lead_ii, 0.55 * lead_ii, silence, -0.8 * lead_ii


PRESSURE, TEMPERATURE = 0x1B, 0x1A


class AirSensor(Protocol):
    """A pressure sensor that also measures temperature."""

    def raw(self, wearer: Wearer, t: Floats) -> tuple[Words, Words]:
        """Return raw temperature and pressure."""
        ...

    def air(self, raw_t: int, raw_p: int) -> tuple[float, float]:
        """Return pressure [Pa] and temperature [degrees Celsius] of raw values."""
        ...


def _breeze(wearer: Wearer, t: Floats) -> tuple[Floats, Floats]:
    """Return slow changes of temperature and pressure, between about -1 and 1."""
    slow = np.sin(2 * pi * t / 40.0)
    return slow, 0.5 * slow + wearer.noise(t, 0.1, "air")


@dataclass(frozen=True)
class Bmp280:
    """Sensor of newer Shimmer3s, with the coefficients of the data sheet's example (3.12)."""

    temperature: tuple[int, int, int] = (27504, 26435, -1000)
    pressure: tuple[int, ...] = (36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000)

    @property
    def coefficients(self) -> bytes:
        """Its coefficients."""
        return struct.pack("<HhhH8h", *self.temperature, *self.pressure)

    def raw(self, wearer: Wearer, t: Floats) -> tuple[Words, Words]:
        """Return raw values: the upper 16 of 20 bits, and 24 bits of which 20 are valid."""
        slow, quick = _breeze(wearer, t)
        raw_p = np.rint(415148 + 300 * quick) * 16
        return np.rint(32493 + 60 * slow).astype(np.int64), raw_p.astype(np.int64)

    def air(self, raw_t: int, raw_p: int) -> tuple[float, float]:
        """Return pressure and temperature by the floating-point formula (data sheet, 8.1)."""
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
    """Sensor of older Shimmer3s, with the coefficients of the data sheet's example (3.5)."""

    words: tuple[int, ...] = (408, -72, -14383, 32741, 32757, 23153, 6190, 4, -32768, -8711, 2868)
    oversampling: int = 0

    @property
    def coefficients(self) -> bytes:
        """Its coefficients."""
        return struct.pack(">3h3H5h", *self.words)

    def raw(self, wearer: Wearer, t: Floats) -> tuple[Words, Words]:
        """Return raw values: 16 bits, and 24 bits of which 16 plus oversampling are valid."""
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
    """Sensor of a Shimmer3R, which reports pascals and degrees directly."""

    @property
    def coefficients(self) -> bytes:
        """Its coefficients: none are needed."""
        return b""

    def raw(self, wearer: Wearer, t: Floats) -> tuple[Words, Words]:
        """Return raw values in 1/65536 degree and 1/64 Pa."""
        slow, quick = _breeze(wearer, t)
        raw_t = np.rint((31.0 + 0.4 * slow) * 65536).astype(np.int64)
        return raw_t, np.rint((100800 + 30 * quick) * 64).astype(np.int64)

    def air(self, raw_t: int, raw_p: int) -> tuple[float, float]:
        """Return pressure and temperature."""
        return raw_p / 64.0, raw_t / 65536.0


@dataclass(frozen=True)
class MotionSensor:
    """A three-axis motion sensor.

    If calibrated, it reads ``K R v + b`` for a quantity v; the 21-byte block in a unit's memory
    contains b and K as words and R in hundredths.
    """

    data_name: str
    channels: tuple[int, int, int]  # Channel ids of X, Y, Z.
    # offset, sensitivity: b, and the diagonal of K in counts per unit.
    offset: Triple
    sensitivity: Triple
    alignment: tuple[Triple, Triple, Triple]  # R, row by row.
    per_unit: float = 1.0  # Number of its units (m/s^2, deg/s, local flux) per unit of the stream.
    limits: tuple[int, int] = (-32768, 32767)  # Smallest and largest count.
    word_scale: int = 1  # Factor of the sensitivity in memory.

    @property
    def block(self) -> bytes:
        """The calibration block in the unit's memory."""
        words = [round(each) for each in self.offset]
        words += [round(each * self.word_scale) for each in self.sensitivity]
        rows = [round(each * 100) for row in self.alignment for each in row]
        return struct.pack(">6h9b", *words, *rows)

    def counts(self, values: Floats) -> Words:
        """Return the counts of values, both of shape (n, 3)."""
        turned = values * self.per_unit @ np.array(self.alignment).T
        counts = np.rint(turned * np.array(self.sensitivity) + np.array(self.offset))
        return np.clip(counts, *self.limits).astype(np.int64)

    def values(self, counts: Words) -> Floats:
        """Return the values of counts, in the units of the stream."""
        turned = (counts - np.array(self.offset)) / np.array(self.sensitivity)
        values = np.linalg.solve(np.array(self.alignment), turned.T).T / self.per_unit
        return values.astype(np.float64)


def acting_on(wearer: Wearer, data_name: str, t: Floats) -> Floats:
    """Return the quantity measured by a stream's motion sensor, in its units, shape (n, 3)."""
    if data_name.startswith("acc"):
        return wearer.acceleration_g(t)
    if data_name == "gyro":
        sway = 4.0 * np.sin(2 * pi * t / 3.0)
        parts = (sway, 0.5 * sway, -0.2 * sway)
        noises = [wearer.noise(t, 0.3, f"gyro {axis}") for axis in "xyz"]
    else:
        parts = (np.full(t.shape, 0.42), np.full(t.shape, -0.11), np.full(t.shape, -0.9))
        noises = [wearer.noise(t, 0.003, f"mag {axis}") for axis in "xyz"]
    return np.stack([part + noise for part, noise in zip(parts, noises, strict=True)], axis=1)


def memory_of(*sensors: MotionSensor | None) -> bytes:
    """Return the calibration blocks of sensors; None for one that was never calibrated."""
    return b"".join(UNWRITTEN if each is None else each.block for each in sensors)


def tuples(values: Floats) -> Sequence[tuple[float, ...]]:
    """Return rows as tuples of floats."""
    return [tuple(row) for row in values.tolist()]
