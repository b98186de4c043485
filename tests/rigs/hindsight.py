"""What can be said of a device's clock when all packets have come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def line_in_hindsight(device_s: Floats, arrival_s: Floats) -> Floats:
    """Return the arrival that each packet would have had with the smallest delay.

    It is the highest straight line under all packets, measured at their mean device time.

    Parameters
    ----------
    device_s, arrival_s : shape (n,)
        In seconds.
    """
    middle_s = float(device_s.mean())
    slopes = np.arange(-250e-6, 250e-6, 1e-6)
    behind_s = arrival_s - device_s
    heights_s = np.array([(behind_s - slope * (device_s - middle_s)).min() for slope in slopes])
    best = int(heights_s.argmax())
    line_s: Floats = device_s + heights_s[best] + slopes[best] * (device_s - middle_s)
    return line_s
