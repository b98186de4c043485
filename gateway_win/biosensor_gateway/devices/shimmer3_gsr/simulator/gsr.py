"""The skin conductance amplifier of a GSR+ board: four feedback resistors, one converter.

A non-inverting amplifier with 0.5 V across the skin: ``V = 0.5 V * (1 + Rf * G)``,
12 bits of 3 V.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import nan

AUTO_RANGE = 4
_FEEDBACK_KOHM = (40.2, 287.0, 1000.0, 3300.0)
_OPEN_COUNTS = 682.5
"""Reading at 0.5 V."""
_FULL_SCALE_COUNTS = 4095
# Reading above which the next smaller, below which the next larger resistor is taken.
_SWITCH_UP = (_FULL_SCALE_COUNTS + 1, 3960, 3700, 3930)
_SWITCH_DOWN = (1120, 1490, 1630, -1)
_HOLD_TICKS = 2621
_SMALLEST_KOHM = 8.0
_FIXED_KOHM = ((8.0, 63.0), (63.0, 220.0), (220.0, 680.0), (680.0, 4700.0))


def counts_in(gsr_range: int, microsiemens: float) -> int:
    """Return the converter's reading of a conductance with one of the resistors, 0 to 3."""
    gain = 1 + microsiemens * _FEEDBACK_KOHM[gsr_range] / 1000
    return min(int(_OPEN_COUNTS * gain), _FULL_SCALE_COUNTS)


def conductance_us(raw: int, setting: int) -> float:
    """Return the conductance that a raw word stands for [uS]; NaN for open electrodes.

    Parameters
    ----------
    raw
        Resistor in the upper two bits, reading in the lower twelve.
    setting
        0 to 3 for a fixed resistor, which outweighs the word's bits; 4 for auto-range.
    """
    gsr_range, counts = raw >> 14 if setting == AUTO_RANGE else setting, raw & 0xFFF
    if counts <= (683 if gsr_range == 3 else 682):
        return nan
    kohm = _FEEDBACK_KOHM[gsr_range] / (counts / _OPEN_COUNTS - 1)
    if setting == AUTO_RANGE:
        return 1000 / max(kohm, _SMALLEST_KOHM)
    low, high = _FIXED_KOHM[gsr_range]
    return 1000 / min(max(kohm, low), high)


class GsrAmplifier:
    """The amplifier over time.

    Parameters
    ----------
    setting
        0 to 3 for a fixed resistor, 4 for auto-range, which begins with the smallest.
    divider
        Ticks between two samples.
    """

    def __init__(self, setting: int, divider: int) -> None:
        self._auto = setting == AUTO_RANGE
        self._range = 0 if self._auto else setting
        self._held_samples = _HOLD_TICKS // divider
        self._to_hold = 0
        self._last_good = 0

    def measure(self, microsiemens: Iterable[float]) -> list[int]:
        """Return the raw words of conductances, sample by sample."""
        return [self._sample(value) for value in microsiemens]

    def _sample(self, microsiemens: float) -> int:
        if self._to_hold:
            self._to_hold -= 1
            return self._last_good
        counts = counts_in(self._range, microsiemens)
        self._last_good = self._range << 14 | counts
        if self._auto:
            self._switch(counts)
        return self._last_good

    def _switch(self, counts: int) -> None:
        """Take another resistor; the amplifier settles while the last value is repeated."""
        step = (counts < _SWITCH_DOWN[self._range]) - (counts > _SWITCH_UP[self._range])
        if step:
            self._range += step
            self._to_hold = self._held_samples
