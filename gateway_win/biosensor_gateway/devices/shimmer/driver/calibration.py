"""Converts a Shimmer's counts to units: ADC voltages, motion sensors and ExG chips.

The ADC has 12 bits for 3 V. Motion sensors use the device's own calibration, or typical values of
their chips. A calibration block in the device's memory has 21 bytes: offset and sensitivity of
each axis as three signed big-endian words each, and the alignment matrix in hundredths as nine
signed bytes, row by row. A reading u becomes R^-1 K^-1 (u - b). Layout and typical values are from
Shimmer's firmware (log-and-stream-common, Calibration).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from biosensor_gateway.devices.shimmer.driver.messages import BLOCK_BYTES

ADC_MAX = 4095
ADC_VOLTS = 3.0

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
REGISTERS = 10
_CONFIG1, _CONFIG2, _LOFF, _CH1SET, _CH2SET, _RLD_SENS, _LOFF_SENS = range(7)

_REFERENCE_UV = 2.42e6
_FULL_SCALE = {24: (1 << 23) - 1, 16: (1 << 15) - 1}
# For 16 bits, the firmware takes the bits below the highest of the 24, which doubles the gain.
_FIRMWARE_GAIN = {24: 1, 16: 2}
_GAINS = {0: 6, 1: 1, 2: 2, 3: 3, 4: 4, 5: 8, 6: 12}
_GAIN_SHIFT, _GAIN_MASK, _INPUT_MASK = 4, 0x7, 0xF
_TEST_SIGNAL, _CHANNEL_3 = 0x5, 0x9
_COMPARATORS_ON = 0x40
# Set by the firmware itself in chip 1, on boards where both chips share a clock.
_CLOCK_OUT = 0x08
_SLOWEST_HZ, _FASTEST_SETTING = 125.0, 6

_ECG = (bytes.fromhex("00a010 40402d 0000 0203"), bytes.fromhex("00a010 404700 0000 0201"))
_EMG = (bytes.fromhex("00a010 696020 0000 0203"), bytes.fromhex("00a010 e1e100 0000 0201"))
# Lead-off current 22 nA; an input is off above 90 % or below 10 % of the supply.
_DIRECT_CURRENT = 0x54
_RLD_SENSED = 0x10
_SENSED_INPUTS = (0x07, 0x04)


def millivolts(raw: ArrayLike) -> Floats:
    """Return ADC values as voltages at the pin [mV]."""
    return np.asarray(raw, np.float64) * (1000 * ADC_VOLTS / ADC_MAX)


STANDARD_GRAVITY_MS2 = 9.80665

_BLOCK = struct.Struct(">6h9b")
_GYRO_SCALE = 100.0
_ALIGNMENT_SCALE = 100.0
_SMALLEST_DETERMINANT = 0.01

_Rows = tuple[tuple[int, int, int], tuple[int, int, int], tuple[int, int, int]]


class Block(IntEnum):
    """Index of a sensor's block in a device's memory."""

    LN_ACCEL = 0
    GYRO = 1
    MAG = 2
    WR_ACCEL = 3


@dataclass(frozen=True, slots=True)
class Kinematic:
    """Calibration of one three-axis sensor.

    Attributes
    ----------
    offset : ndarray of float, shape (3,)
        b, in counts.
    matrix : ndarray of float, shape (3, 3)
        R^-1 K^-1, units per count.
    """

    offset: Floats
    matrix: Floats

    @classmethod
    def of(cls, offset: ArrayLike, sensitivity: ArrayLike, alignment: ArrayLike) -> Kinematic:
        """Create it from b, the diagonal of K, and R."""
        inverse = np.linalg.inv(np.asarray(alignment, np.float64))
        return cls(np.asarray(offset, np.float64), inverse / np.asarray(sensitivity, np.float64))

    def apply(self, raw: ArrayLike) -> Floats:
        """Return readings in units.

        Parameters
        ----------
        raw : array_like, shape (n, 3)
            Counts of X, Y, Z.

        Returns
        -------
        ndarray of float, shape (n, 3)
            In m/s^2, deg/s, or the local magnetic flux.
        """
        return (np.asarray(raw, np.float64) - self.offset) @ self.matrix.T


def stored(memory: bytes, block: Block) -> Kinematic | None:
    """Return a sensor's calibration from a device's memory; None if there is none.

    Parameters
    ----------
    memory
        All blocks, as in :class:`~.messages.Calibration`.
    block
        The sensor's block. It is invalid if it was never written (all FF or 00), or has a
        sensitivity below 1 or an alignment without an inverse.
    """
    data = memory[block * BLOCK_BYTES : (block + 1) * BLOCK_BYTES]
    if len(data) < BLOCK_BYTES or set(data) in ({0xFF}, {0x00}):
        return None
    numbers = np.array(_BLOCK.unpack(data), np.float64)
    offset, sensitivity = numbers[:3], numbers[3:6]
    alignment = numbers[6:].reshape(3, 3) / _ALIGNMENT_SCALE
    if np.any(sensitivity < 1) or abs(np.linalg.det(alignment)) < _SMALLEST_DETERMINANT:
        return None
    scale = _GYRO_SCALE if block is Block.GYRO else 1.0
    return Kinematic.of(offset, sensitivity / scale, alignment)


@dataclass(frozen=True, slots=True)
class Typical:
    """Typical calibration of a chip for each setting of its range."""

    alignment: _Rows  # Orientation of the chip in the case.
    # Counts per unit by range setting; the first one is used for unknown settings.
    sensitivity: Mapping[int, float | tuple[float, float, float]]
    offset: float = 0.0

    def at(self, setting: int) -> Kinematic:
        """Return the calibration in a range."""
        first = next(iter(self.sensitivity.values()))
        sensitivity = np.broadcast_to(self.sensitivity.get(setting, first), 3)
        return Kinematic.of(np.full(3, self.offset), sensitivity, self.alignment)


_SWAPPED: _Rows = ((0, -1, 0), (-1, 0, 0), (0, 0, -1))
_TURNED: _Rows = ((-1, 0, 0), (0, 1, 0), (0, 0, -1))

KXRB5_ACCEL = Typical(_SWAPPED, {0: 83.0}, offset=2047.0)
KXTC9_ACCEL = Typical(_SWAPPED, {0: 92.0}, offset=2253.0)
MPU9150_GYRO = Typical(_SWAPPED, {0: 131.0, 1: 65.5, 2: 32.8, 3: 16.4})
LSM303DLHC_ACCEL = Typical(_TURNED, {0: 1631.0, 1: 815.0, 2: 408.0, 3: 135.0})
LSM303DLHC_MAG = Typical(
    _TURNED,
    {
        1: (1100.0, 1100.0, 980.0),
        2: (855.0, 855.0, 760.0),
        3: (670.0, 670.0, 600.0),
        4: (450.0, 450.0, 400.0),
        5: (400.0, 400.0, 355.0),
        6: (330.0, 330.0, 295.0),
        7: (230.0, 230.0, 205.0),
    },
)
_LSM303AH: _Rows = ((0, -1, 0), (1, 0, 0), (0, 0, -1))
# The order of ranges is the chip's own.
LSM303AH_ACCEL = Typical(_LSM303AH, {0: 1671.0, 2: 836.0, 3: 418.0, 1: 209.0})
LSM303AH_MAG = Typical(_LSM303AH, {0: 667.0})
LSM6DSV_ACCEL = Typical(_TURNED, {0: 1672.0, 1: 836.0, 2: 418.0, 3: 209.0})
LSM6DSV_GYRO = Typical(_TURNED, {0: 229.0, 1: 114.0, 2: 57.0, 3: 29.0, 4: 14.0, 5: 7.0})
LIS2DW12_ACCEL = Typical(_SWAPPED, {0: 1671.0, 1: 836.0, 2: 418.0, 3: 209.0})
LIS2MDL_MAG = Typical(((-1, 0, 0), (0, -1, 0), (0, 0, -1)), {0: 667.0})


class Use(StrEnum):
    """Use of the chips; the values are data names."""

    ECG = "ecg"
    EMG = "emg"


DEFAULT_GAIN = {Use.ECG: 4, Use.EMG: 12}
GAINS = tuple(sorted(_GAINS.values()))

Registers = tuple[bytes, bytes]
"""Ten registers of each chip."""


@dataclass(frozen=True, slots=True)
class Exg:
    """The setup of both chips (ADS1292R).

    Registers are as in Texas Instruments' data sheet SBAS502; the assignment of electrodes and the
    usual settings for ECG and EMG are from Shimmer's manuals and APIs. The firmware's status byte
    consists of 1, two zeros, and then from the highest bit RLD, IN2N, IN2P, IN1N, IN1P, each 1
    while that lead is off.
    """

    registers: Registers

    @property
    def use(self) -> Use:
        """EMG if the first channel of chip 1 is routed to channel 3, else ECG."""
        is_emg = self.registers[0][_CH1SET] & _INPUT_MASK == _CHANNEL_3
        return Use.EMG if is_emg else Use.ECG

    @property
    def is_test_signal(self) -> bool:
        """Whether the first channel measures the chip's own square wave."""
        return self.registers[0][_CH1SET] & _INPUT_MASK == _TEST_SIGNAL

    @property
    def detects_lead_off(self) -> bool:
        """Whether lead-off detection is on."""
        return bool(self.registers[0][_CONFIG2] & _COMPARATORS_ON)

    def gain(self, chip: int, channel: int) -> int:
        """Return the gain of a channel (1 or 2) of a chip (0 or 1); 1 for a reserved setting."""
        register = self.registers[chip][(_CH1SET, _CH2SET)[channel - 1]]
        return _GAINS.get(register >> _GAIN_SHIFT & _GAIN_MASK, 1)


def registers_for(use: Use, gain: int, rate_hz: float, *, lead_off: bool) -> Registers:
    """Return the registers of both chips.

    Parameters
    ----------
    gain
        One of `GAINS`.
    rate_hz
        Sample rate of the device; the chips are set to the next higher rate.
    lead_off
        Whether to detect loose electrodes with direct current; only for ECG.
    """
    made = [bytearray(each) for each in (_ECG if use is Use.ECG else _EMG)]
    code = next(code for code, value in _GAINS.items() if value == gain)
    for chip, registers in enumerate(made):
        registers[_CONFIG1] = _rate_setting(rate_hz)
        if use is Use.ECG or chip == 0:
            for at in (_CH1SET, _CH2SET):
                registers[at] = registers[at] & ~(_GAIN_MASK << _GAIN_SHIFT) | code << _GAIN_SHIFT
        if lead_off and use is Use.ECG:
            registers[_CONFIG2] |= _COMPARATORS_ON
            registers[_LOFF] = _DIRECT_CURRENT
            registers[_LOFF_SENS] = _SENSED_INPUTS[chip]
            registers[_RLD_SENS] |= 0 if chip else _RLD_SENSED
    return bytes(made[0]), bytes(made[1])


def are_same(present: bytes, wanted: bytes) -> bool:
    """Whether a chip is set up as wanted, ignoring what the firmware sets itself."""
    without = bytearray(present)
    if len(without) > _CONFIG2:
        without[_CONFIG2] &= ~_CLOCK_OUT
    return bytes(without) == wanted


def microvolts(raw: ArrayLike, gain: int, bits: int) -> Floats:
    """Return the voltage between two electrodes [uV].

    Parameters
    ----------
    raw
        Signed values of a channel.
    gain
        Gain of the chip's amplifier.
    bits
        16 or 24, as sent.
    """
    scale = _REFERENCE_UV / (gain * _FIRMWARE_GAIN[bits]) / _FULL_SCALE[bits]
    return np.asarray(raw, np.float64) * scale


def electrodes_on(status_1: int, status_2: int) -> tuple[float, float, float, float]:
    """Return from both chips' status whether RA, LA, LL and V1 are on the skin, 1 or 0."""
    off = status_1 >> 1 & 1, status_1 >> 2 & 1, status_1 & 1, status_2 >> 2 & 1
    right_arm, left_arm, left_leg, chest = (float(not each) for each in off)
    return right_arm, left_arm, left_leg, chest


def _rate_setting(rate_hz: float) -> int:
    setting = 0
    while rate_hz >= _SLOWEST_HZ * (1 << setting) and setting < _FASTEST_SETTING:
        setting += 1
    return setting
