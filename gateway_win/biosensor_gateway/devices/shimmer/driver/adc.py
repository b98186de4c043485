"""The converter of a Shimmer3: 12 bits of 3 V."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

ADC_MAX = 4095
ADC_VOLTS = 3.0

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def millivolts(raw: ArrayLike) -> Floats:
    """Return ADC values as voltages at the pin [mV]."""
    return np.asarray(raw, np.float64) * (1000 * ADC_VOLTS / ADC_MAX)
