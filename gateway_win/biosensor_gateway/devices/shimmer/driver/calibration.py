"""Converts counts to units: ADC voltages and motion sensors of a Shimmer3.

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
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from biosensor_gateway.devices.shimmer.driver.messages import BLOCK_BYTES

ADC_MAX = 4095
ADC_VOLTS = 3.0

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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
    """Typical calibration of a chip for each setting of its range.

    Attributes
    ----------
    alignment
        Orientation of the chip in the case.
    sensitivity
        Counts per unit by range setting; the first one is used for unknown settings.
    offset
        Offset in counts.
    """

    alignment: _Rows
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
