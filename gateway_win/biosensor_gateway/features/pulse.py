"""Finds pulses in a photoplethysmogram by two moving averages, as in Elgendi 2013.

References are in :mod:`.thresholds`. The filter is causal, so the apex is looked for in the signal
as it was measured, around where the filtered one had its own.
"""

from __future__ import annotations

import math
from collections import deque

from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.filters import Biquad, Decimator, MovingMean
from biosensor_gateway.features.runs import Array

# How far the filter's group delay moves an apex, at most.
_APEX_S = 0.12


class Polarity:
    """Tells which way up a pulse is by its skewness: upright it is skewed to the right.

    A sensor that counts reflected light shows it upside down, for blood takes light up.

    Parameters
    ----------
    rate
        Of the samples, in Hz.

    Attributes
    ----------
    sign
        -1 while it is upside down, else 1.
    """

    def __init__(self, rate: float) -> None:
        self.sign = 1.0
        self._kept_share = math.exp(-1 / (at.PULSE_SKEWNESS_S * rate))
        self._least = at.PULSE_SKEWNESS_LEAST_S * rate
        self._squares = self._cubes = self._weight = 0.0

    def take(self, filtered: float) -> float:
        """Return the sign after this sample."""
        square = filtered * filtered
        self._squares = self._kept_share * self._squares + square
        self._cubes = self._kept_share * self._cubes + square * filtered
        self._weight = self._kept_share * self._weight + 1.0
        # The same as comparing skewness, without dividing by what may be 0.
        limit = at.PULSE_SKEWNESS * self._squares * math.sqrt(self._squares / self._weight)
        if self._weight >= self._least and -self.sign * self._cubes > limit:
            self.sign = -self.sign
        return self.sign


class Pulses:
    """Gives the stamp of the apex of each pulse.

    Parameters
    ----------
    rate
        Nominal, in Hz.
    """

    def __init__(self, rate: float) -> None:
        self._decimator = Decimator(rate, at.PULSE_RATE_HZ)
        slow = self._decimator.rate
        self._high_pass = Biquad(at.PULSE_BAND_HZ[0], slow, is_high_pass=True)
        self._low_pass = Biquad(at.PULSE_BAND_HZ[1], slow, is_high_pass=False)
        self._polarity = Polarity(slow)
        peak, beat = (2 * round(s * slow / 2) + 1 for s in (at.PULSE_PEAK_S, at.PULSE_BEAT_S))
        self._peak_mean, self._beat_mean = MovingMean(peak), MovingMean(beat)
        self._offset = MovingMean(round(at.PULSE_MEAN_S * slow))
        # Centred, the longer mean would look ahead by 0.28 s; less will do for an upstroke.
        self._wait = min((beat - peak) // 2, round(at.PULSE_AHEAD_S * slow))
        self._late = self._wait + (peak - 1) // 2
        self._least = peak
        self._peaks: deque[float] = deque(maxlen=self._wait + 1)
        self._around = round(_APEX_S * slow)
        self._kept: deque[tuple[float, float, float]] = deque(maxlen=round(3 * slow))
        self._refractory_s = at.REFRACTORY_S
        self._length = 0
        self._last = float("-inf")

    def take(self, stamps: Array, values: Array) -> list[float]:
        """Return the stamps of the pulses that are decided by now; both of shape (n,)."""
        found = (self._sample(*each) for each in self._decimator.take(stamps, values))
        return [stamp for stamp in found if stamp is not None]

    def _sample(self, stamp: float, value: float) -> float | None:
        filtered = self._low_pass.take(self._high_pass.take(value))
        upright = filtered * self._polarity.take(filtered)
        clipped = upright * upright if upright > 0 else 0.0
        self._kept.append((stamp, value, filtered))
        self._peaks.append(self._peak_mean.take(clipped))
        beat = self._beat_mean.take(clipped)
        limit = beat + at.PULSE_OFFSET * self._offset.take(clipped)
        if self._peaks[0] > limit and len(self._kept) > self._late + self._around:
            self._length += 1
            return None
        length, self._length = self._length, 0
        return self._apex(length) if length >= self._least else None

    def _apex(self, length: int) -> float | None:
        kept, sign = list(self._kept), self._polarity.sign
        end = len(kept) - 1 - self._late
        begin = max(0, end - length)
        top = max(range(begin, end), key=lambda place: sign * kept[place][2], default=None)
        if top is None:
            return None
        around = range(max(0, top - self._around), min(len(kept), top + self._around // 2 + 1))
        stamp = kept[max(around, key=lambda place: sign * kept[place][1])][0]
        if stamp - self._last < self._refractory_s:
            return None
        self._last = stamp
        return stamp
