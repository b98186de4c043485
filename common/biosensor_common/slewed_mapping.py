"""Moves the mapping of a device's clock to where it should be, without a jump."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

from biosensor_common.lower_envelope import LowerEnvelope

SLEW_TIME_CONSTANT_S = 1.0
SLEW_LIMIT = 0.5
"""Reached only by a step or a backlog at the start: usual errors make less than 1 %."""
SLEW_SHARE = 0.25
"""Largest part of an error taken off in one segment: keeps the spacing at one packet a second."""
SEGMENT_MIN_S = 0.05
HISTORY_SEGMENTS = 512
"""At least 12 s of mapping stay valid for late samples."""


class SlewedMapping:
    """Continuous, strictly increasing map of device to LSL time, both from the anchor.

    Parameters
    ----------
    slope : float
        Expected drift, seconds per second.
    """

    def __init__(self, slope: float) -> None:
        # The piece before the anchor is separate, so that later bends leave it alone.
        rate = 1.0 + slope
        self._starts = [-SEGMENT_MIN_S, 0.0]
        self._values = [-SEGMENT_MIN_S * rate, 0.0]
        self._rates = [rate, rate]

    def at(self, x: float) -> float:
        """Map a time."""
        return self.all_at([x])[0]

    def all_at(self, times: Sequence[float], x0: float = 0.0, y0: float = 0.0) -> list[float]:
        """Map times that count from `x0`, to such that count from `y0`."""
        starts, values, rates = self._starts, self._values, self._rates
        mapped: list[float] = []
        for time in times:
            x = time - x0
            piece = max(bisect_right(starts, x) - 1, 0)
            mapped.append(y0 + (values[piece] + rates[piece] * (x - starts[piece])))
        return mapped

    def advance(self, x: float, target: LowerEnvelope) -> None:
        """Fix the map up to `x`, on the way to the target line."""
        start, value = self._starts[-1], self._values[-1]
        step = x - start
        if step <= 0.0:
            return
        drift_rate = 1.0 + target.slope
        if x - self._starts[-2] < SEGMENT_MIN_S:
            # Packets of a few ms lengthen the piece at its rate, to bound the number of pieces.
            value = self._values[-2] + self._rates[-2] * (x - self._starts[-2])
            self._starts[-1], self._values[-1], self._rates[-1] = x, value, drift_rate
            return
        self._rates[-1] = drift_rate + _slew(start + target.at(start) - value, step)
        self._starts.append(x)
        self._values.append(value + self._rates[-1] * step)
        self._rates.append(drift_rate)
        if len(self._starts) > 2 * HISTORY_SEGMENTS:
            for column in (self._starts, self._values, self._rates):
                del column[:-HISTORY_SEGMENTS]


def _slew(error: float, step: float) -> float:
    """Return the rate, in s/s, at which to take off an error over the next `step` seconds."""
    share = min(1.0 - math.exp(-step / SLEW_TIME_CONSTANT_S), SLEW_SHARE)
    return min(max(error * share / step, -SLEW_LIMIT), SLEW_LIMIT)
