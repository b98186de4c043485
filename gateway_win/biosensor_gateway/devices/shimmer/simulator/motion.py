"""Motion sensors of a virtual Shimmer: how a movement becomes counts, and what counts stand for.

A sensor that is calibrated reads ``K R v + b`` of what acts on it, v; the block of 21 bytes in
a unit's memory holds b and K as words and R in hundredths.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.simulation.wearer import Floats, Wearer

Triple = tuple[float, float, float]
Words = NDArray[np.int64]

GRAVITY_MS2 = 9.80665
LN_ACCEL, WR_ACCEL = (0x00, 0x01, 0x02), (0x04, 0x05, 0x06)
MAG, GYRO = (0x07, 0x08, 0x09), (0x0A, 0x0B, 0x0C)
UNWRITTEN = b"\xff" * 21


@dataclass(frozen=True)
class MotionSensor:
    """A sensor of three axes.

    Attributes
    ----------
    data_name
        Its stream.
    channels
        Ids of X, Y, Z.
    offset, sensitivity
        b, and the diagonal of K in counts per unit.
    alignment
        R, row by row.
    per_unit
        How many of its units (m/s^2, deg/s, local flux) are one of the stream's.
    limits
        Least and largest count.
    word_scale
        By which the sensitivity is multiplied in memory.
    """

    data_name: str
    channels: tuple[int, int, int]
    offset: Triple
    sensitivity: Triple
    alignment: tuple[Triple, Triple, Triple]
    per_unit: float = 1.0
    limits: tuple[int, int] = (-32768, 32767)
    word_scale: int = 1

    @property
    def block(self) -> bytes:
        """What the factory wrote into the unit's memory."""
        words = [round(each) for each in self.offset]
        words += [round(each * self.word_scale) for each in self.sensitivity]
        rows = [round(each * 100) for row in self.alignment for each in row]
        return struct.pack(">6h9b", *words, *rows)

    def counts(self, values: Floats) -> Words:
        """Return what it reads; values and counts have the shape (n, 3)."""
        turned = values * self.per_unit @ np.array(self.alignment).T
        counts = np.rint(turned * np.array(self.sensitivity) + np.array(self.offset))
        return np.clip(counts, *self.limits).astype(np.int64)

    def values(self, counts: Words) -> Floats:
        """Return what counts stand for, in the units of the stream."""
        turned = (counts - np.array(self.offset)) / np.array(self.sensitivity)
        values = np.linalg.solve(np.array(self.alignment), turned.T).T / self.per_unit
        return values.astype(np.float64)


def acting_on(wearer: Wearer, data_name: str, t: Floats) -> Floats:
    """Return what a motion sensor of that stream is exposed to, shape (n, 3), in its units."""
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
    """Return the blocks of sensors in their order; None is one that was never calibrated."""
    return b"".join(UNWRITTEN if each is None else each.block for each in sensors)


def tuples(values: Floats) -> Sequence[tuple[float, ...]]:
    """Return rows as tuples of floats."""
    return [tuple(row) for row in values.tolist()]
