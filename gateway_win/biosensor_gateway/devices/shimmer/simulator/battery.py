"""The battery of a Shimmer3: what its converter reads at which charge."""

from __future__ import annotations

import numpy as np

FULL_SCALE_V = 3.0 * 1.988
"""Of the 12-bit converter, behind the divider."""
_FULL_SCALE_COUNTS = 4095
_LOW_COUNTS, _MIDDLE_COUNTS = 2568, 2717
# Vendor's discharge curve.
_VOLTS = (
    *(3.2, 3.627, 3.645, 3.663, 3.681, 3.699, 3.717, 3.7314, 3.735, 3.7386, 3.7566, 3.771, 3.789),
    *(3.8034, 3.8106, 3.8394, 3.861, 3.8826, 3.9078, 3.933, 3.969, 4.0086, 4.041, 4.0734, 4.113),
    4.167,
)
_PERCENT = (
    *(0.0, 5.9, 9.8, 13.8, 17.7, 21.6, 25.6, 29.5, 33.4, 37.4, 41.3, 45.2, 49.2),
    *(53.1, 57.0, 61.0, 64.9, 68.9, 72.8, 76.7, 80.7, 84.6, 88.5, 92.5, 96.4),
    100.0,
)
_UNDOCKED, _CHARGING, _FULL = 0xFF, 0x80, 0x40


def counts_at(percent: float) -> int:
    """Return the converter's reading at a charge [percent]."""
    volts = float(np.interp(percent, _PERCENT, _VOLTS))
    return round(volts / FULL_SCALE_V * _FULL_SCALE_COUNTS)


def percent_of(counts: int) -> float:
    """Return the charge that a reading of the converter stands for [percent]."""
    return float(np.interp(counts * FULL_SCALE_V / _FULL_SCALE_COUNTS, _VOLTS, _PERCENT))


def charger_byte(counts: int, *, docked: bool) -> int:
    """Return what the charger says: nothing without a dock, charging, or full."""
    if not docked:
        return _UNDOCKED
    return _FULL if counts >= counts_at(100) else _CHARGING


def led_level(counts: int) -> int:
    """Return the colour of the battery's lamp: 1 low, 2 middle, 4 high."""
    if counts < _LOW_COUNTS:
        return 1
    return 2 if counts < _MIDDLE_COUNTS else 4
