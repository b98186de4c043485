"""Skin conductance from what a Shimmer's ADC saw.

The GSR+ unit puts 0.5 V across the skin and amplifies the current with one of four
feedback resistors, so the ADC sees 0.5 V * (1 + Rf / Rskin). Constants and limits are
those of Shimmer's Java and C# APIs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from biosensor_gateway.devices.shimmer.driver.adc import ADC_MAX, ADC_VOLTS, Floats, Ints
from biosensor_gateway.devices.shimmer.driver.commands import AUTO_RANGE

FEEDBACK_KOHM = (40.2, 287.0, 1000.0, 3300.0)
LARGEST_OPEN_ADC = 683
"""Of range 3: the amplifier's output for no current at all, rounded up."""

_EXCITATION_VOLTS = 0.5
_RANGE_SHIFT = 14
_ADC_MASK = 0x0FFF
_AUTO_LIMITS_KOHM = (8.0, np.inf)
_FIXED_LIMITS_KOHM = ((8.0, 63.0), (63.0, 220.0), (220.0, 680.0), (680.0, 4700.0))


def gsr_ranges(raw: ArrayLike, setting: int) -> Ints:
    """Return the feedback resistor in use for each sample, 0 to 3.

    Parameters
    ----------
    raw : array_like of int, shape (n,)
        16-bit values of the GSR channel.
    setting : int
        0 to 3, or 4 for automatic; only then the device says it in the upper bits.
    """
    raw = np.asarray(raw, np.int64)
    return raw >> _RANGE_SHIFT if setting == AUTO_RANGE else np.full(raw.shape, setting)


def conductance_us(raw: ArrayLike, setting: int) -> Floats:
    """Return the skin conductance in microsiemens; NaN where no current flows.

    Parameters
    ----------
    raw, setting
        As for `gsr_ranges`.

    Returns
    -------
    ndarray of float, shape (n,)
        With a fixed range, resistances outside of it are taken to its end, as the
        vendor's APIs do.
    """
    ranges = gsr_ranges(raw, setting)
    adc = np.asarray(raw, np.int64) & _ADC_MASK
    volts = adc * ADC_VOLTS / ADC_MAX
    # At the ADC value nearest to 0.5 V range 3 cannot tell a current from none.
    flows = (volts > _EXCITATION_VOLTS) & ((ranges != 3) | (adc > LARGEST_OPEN_ADC))
    gain = np.where(flows, volts / _EXCITATION_VOLTS - 1, np.nan)
    resistance = np.take(FEEDBACK_KOHM, ranges) / gain
    return 1000.0 / clamped_kohm(resistance, setting)


def clamped_kohm(resistance: ArrayLike, setting: int) -> Floats:
    """Limit resistances [kohm] to what a range setting can measure; NaN stays NaN."""
    limits = _AUTO_LIMITS_KOHM if setting == AUTO_RANGE else _FIXED_LIMITS_KOHM[setting]
    return np.clip(np.asarray(resistance, np.float64), *limits)
