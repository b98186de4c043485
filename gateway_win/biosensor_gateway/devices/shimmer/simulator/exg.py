"""The two ExG chips of a virtual Shimmer, as their registers have them set up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.simulation.wearer import Floats, Wearer

STATUS = (0x1D, 0x20)
CHANNELS_24 = ((0x1E, 0x1F), (0x21, 0x22))
CHANNELS_16 = ((0x23, 0x24), (0x25, 0x26))
# Vendor's usual registers, with lead-off detection by direct current for the ECG.
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
_RAIL_MV = 350.0
"""Of an open input, which the current of the detection drives to its limit."""

Words = NDArray[np.int64]


@dataclass(frozen=True)
class ExgChips:
    """Both chips while they measure.

    Attributes
    ----------
    registers
        Ten of each.
    """

    registers: Sequence[bytes]

    @property
    def is_emg(self) -> bool:
        """Whether channel 1 of chip 1 has the electrodes of its third channel."""
        return self.registers[0][3] & 0x0F == _ROUTED_FROM_CHANNEL_3

    @property
    def detects(self) -> bool:
        """Whether the comparators of both chips look for open electrodes."""
        return all(each[1] & _COMPARATORS for each in self.registers)

    def status(self, chip: int, *, worn: bool) -> int:
        """Return the status byte: of the inputs that are looked at, which are open."""
        return _FRESH | (0 if worn or not self.detects else self.registers[chip][6] & 0x0F)

    def count_v(self, chip: int, channel: int) -> float:
        """Return the voltage of one count of 24 bits, channel 0 or 1."""
        gain = _GAINS[self.registers[chip][3 + channel] >> 4 & 7]
        return _REFERENCE_V / gain / ((1 << 23) - 1)

    def counts(self, chip: int, channel: int, microvolts: Floats, bits: int) -> Words:
        """Return what is sent of a voltage; of 24 bits, 16 are those below the highest."""
        counts = np.rint(microvolts * 1e-6 / self.count_v(chip, channel)).astype(np.int64)
        if bits == 16:
            counts >>= 7
        highest = (1 << (bits - 1)) - 1
        return np.clip(counts, -highest - 1, highest)

    def microvolts(self, chip: int, channel: int, counts: Words, bits: int) -> Floats:
        """Return the voltage that counts stand for, as the vendor's programs have it."""
        volts: Floats = counts.astype(np.float64) * self.count_v(chip, channel)
        if bits == 16:
            volts = volts * ((1 << 23) - 1) / (2 * ((1 << 15) - 1))
        return volts * 1e6


def voltages(wearer: Wearer, t: Floats, *, is_emg: bool, worn: bool) -> tuple[Floats, ...]:
    """Return what is at both channels of both chips [uV]."""
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
