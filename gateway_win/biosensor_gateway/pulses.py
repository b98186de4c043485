"""Finds pulses in a photoplethysmogram by two moving averages, as in Elgendi 2013.

The causal filter delays the apex, so that it is looked for in the unfiltered signal, around the
apex of the filtered one. A limit without a source is a choice of this program; the measurements in
``docs/features.md`` were made with it.

References
----------
.. [1] M. Elgendi et al., "Systolic peak detection in acceleration photoplethysmograms measured
   from emergency responders in tropical conditions", PLoS ONE 8 (2013) e76585.
.. [2] M. Elgendi, "Optimal signal quality index for photoplethysmogram signals", Bioengineering
   3 (2016) 21.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import accumulate
from statistics import median
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

BAND_HZ = (0.5, 8.0)
PEAK_S, BEAT_S = 0.111, 0.667
"""[1]_: the two moving averages."""
AHEAD_S = 0.15
"""How far the longer mean looks ahead; by 0.28 s in [1]_, where it is centred."""
OFFSET = 0.02
"""[1]_: beta, relative to the mean of the squared signal."""
MEAN_S = 3.0
"""Length of that mean."""
SKEWNESS = 0.3
"""[2]_: a good pulse is skewed to the right; with this skewness to the left, it is upside down."""
SKEWNESS_PIECE_S, SKEWNESS_PIECES = 2.0, 8
"""Length of the pieces whose skewness is computed, and number of pieces for the median."""
LEAST_SHARE, RISE_S = 0.23, 0.4
"""Smallest rise of a pulse, as a share of the usual rise, within this time before its top; the
filter makes smaller waves between slow pulses."""
NOISE_TIMES, NOISE_SHARE = 8.0, 0.35
"""A pulse rises by so many standard deviations of the noise in levels; this share of the usual rise
is enough in any case."""
FALL_COUNTS, SMOOTH_S = 2.0, 0.16
"""How much the fall behind a top counts, and over how long levels are averaged."""
EARLY_S, EARLY_SHARE = 0.27, 0.4
"""Shortest interval to an early pulse, and its least share of the usual height."""
VALLEY_SHARE = 0.25
REFRACTORY_S = 0.2
"""Shortest interval between two pulses."""
KEPT = 8
"""Number of pulses for medians."""
LOST_S = 4.0
"""Time without a pulse after which the usual size is reset: the sensor may have been moved."""
LEARNING_S = 3.0
"""Time in which the first pulses wait until their usual size is known; a slow heart beats in it."""
# Largest delay of an apex by the filter's group delay.
_APEX_S = 0.12
_KEPT_S = 3.0
# Standard deviation of normal values, relative to the median of their sizes.
_OF_MEDIAN = 1.4826
_Kept = tuple[float, float, float]
"""Stamp, value, and value after the filter."""


class Beat(NamedTuple):
    """A heartbeat in a waveform."""

    stamp: float  # Stamp of the sample at the apex.
    apex_s: float  # Time of the apex, interpolated between samples.
    doubtful_s: float = 0.0  # For so long before it, beats may be none: the signal has grown.


class Polarity:
    """Detects the polarity of a pulse by its skewness: an upright pulse is skewed to the right.

    A sensor of reflected light shows the pulse upside down, because blood absorbs light. The median
    skewness of the last pieces decides, so that an artefact in one or two pieces has no effect.

    Parameters
    ----------
    rate
        Rate of the samples in Hz.

    Attributes
    ----------
    sign
        -1 while the pulse is upside down, else 1.
    """

    def __init__(self, rate: float) -> None:
        self.sign = 1.0
        self._length = round(SKEWNESS_PIECE_S * rate)
        self._piece: list[float] = []
        # nothing is dropped: a memory of skewness
        self._kept: deque[float] = deque(maxlen=SKEWNESS_PIECES)

    def take(self, filtered: float) -> float:
        """Return the sign after this sample."""
        self._piece.append(filtered)
        if len(self._piece) == self._length:
            self._kept.append(moment(np.array(self._piece), 3))
            self._piece.clear()
            if -self.sign * median(self._kept) > SKEWNESS:
                self.sign = -self.sign
        return self.sign


class Pulses:
    """Finds the apex of each pulse.

    Parameters
    ----------
    rate
        Nominal rate in Hz; from 20 to some hundreds.
    """

    def __init__(self, rate: float) -> None:
        self.height = 0.0  # Height of the last pulse, after the filter.
        self._rate = rate
        self._high_pass = Biquad(BAND_HZ[0], rate, is_high_pass=True)
        self._low_pass = Biquad(BAND_HZ[1], rate, is_high_pass=False)
        self._polarity = Polarity(rate)
        peak, beat = (2 * round(s * rate / 2) + 1 for s in (PEAK_S, BEAT_S))
        self._peak_mean, self._beat_mean = MovingMean(peak), MovingMean(beat)
        self._offset = MovingMean(round(MEAN_S * rate))
        # A centred longer mean would look ahead by 0.28 s; an upstroke needs less.
        self._wait = min((beat - peak) // 2, round(AHEAD_S * rate))
        self._late = self._wait + (peak - 1) // 2
        self._least = peak
        # nothing is dropped: what a maximum slides over
        self._peaks: deque[float] = deque(maxlen=self._wait + 1)
        self._around = round(_APEX_S * rate)
        self._smooth = round(SMOOTH_S * rate / 2)
        # nothing is dropped: no pulse lasts longer
        self._kept: deque[_Kept] = deque(maxlen=round(_KEPT_S * rate))
        # nothing is dropped: a memory of heights
        self._heights: deque[float] = deque(maxlen=KEPT)
        self._rises: deque[float] = deque(maxlen=KEPT)  # nothing is dropped: a memory of rises
        self._held: list[tuple[Beat, float]] | None = []
        self._length = 0
        self._last = float("-inf")

    def take(self, stamp: float, value: float) -> list[Beat]:
        """Take the next sample; return the pulses that it decides."""
        filtered = self._low_pass.take(self._high_pass.take(value))
        upright = filtered * self._polarity.take(filtered)
        clipped = upright * upright if upright > 0 else 0.0
        self._kept.append((stamp, value, filtered))
        self._peaks.append(self._peak_mean.take(clipped))
        beat = self._beat_mean.take(clipped)
        limit = beat + OFFSET * self._offset.take(clipped)
        if self._peaks[0] > limit and len(self._kept) > self._late + self._around:
            self._length += 1
            return []  # nothing is dropped: the pulse goes on
        length, self._length = self._length, 0
        return self._block(length) if length >= self._least else []

    def _block(self, length: int) -> list[Beat]:
        """Return the pulse of a block that ends now, preceded by pulses that were missed."""
        kept, sign = list(self._kept), self._polarity.sign
        upright = [sign * each[2] for each in kept]
        end = len(kept) - 1 - self._late
        begin = max(1, end - length)
        top = max(range(begin, end), key=upright.__getitem__, default=None)
        if top is None:
            return []  # nothing is dropped: there was no pulse
        beat = self._beat(kept, top)
        since_s = beat.stamp - self._last
        if since_s > LOST_S:
            self._heights.clear()
            self._rises.clear()
            self._held = []
        rise = self._rise(kept, top)
        least = self._least_rise(kept)
        if since_s < REFRACTORY_S or rise <= 0 or rise < least:
            return []  # nothing is dropped: it is part of another pulse
        passed = self._passed_over(kept, upright, top, least)
        self._last, self.height = beat.stamp, upright[top]
        self._heights.append(upright[top])
        self._rises.append(rise)
        found = [(self._beat(kept, place), each) for place, each in passed]
        return self._known([*found, (beat, rise)])

    def _known(self, found: list[tuple[Beat, float]]) -> list[Beat]:
        """Return pulses once the usual rise is known; before, small waves look like pulses."""
        if self._held is None:
            return [beat for beat, _ in found]
        self._held += found
        if found[-1][0].stamp - self._held[0][0].stamp < LEARNING_S:
            return []  # nothing is dropped: they wait
        held, self._held = self._held, None
        least = LEAST_SHARE * max(rise for _, rise in held)
        large = [rise for rise in self._rises if rise >= least]
        self._rises.clear()
        self._rises.extend(large)
        return [beat for beat, rise in held if rise >= least]

    def _least_rise(self, kept: Sequence[_Kept]) -> float:
        """Return by how much a pulse stands out at least: of other ones, and of white noise."""
        if not self._rises:
            return 0.0
        known = self._rises if self._held is None else [max(self._rises)]
        usual = median(known)
        values = [each[1] for each in kept]
        # Second differences are those of noise at most samples, and their median leaves out others.
        bends = (a - 2 * b + c for a, b, c in zip(values, values[1:], values[2:], strict=False))
        noise = median(map(abs, bends)) * _OF_MEDIAN / math.sqrt(6 * (2 * self._smooth + 1))
        return max(LEAST_SHARE * usual, min(NOISE_SHARE * usual, NOISE_TIMES * noise))

    def _passed_over(
        self, kept: Sequence[_Kept], upright: Sequence[float], top: int, least: float
    ) -> list[tuple[int, float]]:
        """Return tops and rises of early pulses that the previous one hid from the moving means.

        Unlike the dicrotic wave of a pulse, such a top is nearly as high as others, and the signal
        was below its mean before it.
        """
        if not self._heights:
            return []  # nothing is dropped: nothing is known of pulses yet
        near = round(EARLY_S * self._rate)
        begin = next((n for n in range(top) if kept[n][0] >= self._last), top)
        limit = EARLY_SHARE * min(median(self._heights), upright[top])
        found: list[tuple[int, float]] = []
        last = begin
        for place in range(begin + near, top - near):
            is_top = upright[place - 1] < upright[place] >= upright[place + 1]
            if not is_top or upright[place] < limit or place - last < near:
                continue  # nothing is dropped: it is not the top of a pulse
            valley = max(min(upright[last:place]), min(upright[place:top]))
            rise = self._rise(kept, place)
            if valley < VALLEY_SHARE * upright[place] and rise >= least:
                found.append((place, rise))
                last = place
        return found

    def _rise(self, kept: Sequence[_Kept], top: int) -> float:
        """Return by how much a top stands out of the unfiltered signal on both sides.

        Noise is averaged away, and what only rises, as a wandering level does, stands out of
        nothing. A fall counts more, because little of it is known yet.
        """
        sign, near = self._polarity.sign, self._smooth
        begin = max(0, top - round(RISE_S * self._rate) - self._around)
        sums = [0.0, *accumulate(sign * each[1] for each in kept[begin:])]
        width = 2 * near + 1
        levels = [(sums[n + width] - sums[n]) / width for n in range(len(sums) - width)]
        centre = top - begin - near
        around = range(max(0, centre - self._around), min(len(levels), centre + near + 1))
        apex = max(around, key=levels.__getitem__, default=None)
        if apex is None:
            return 0.0
        before = levels[max(0, apex - round(RISE_S * self._rate)) : apex + 1]
        rise, fall = levels[apex] - min(before), levels[apex] - min(levels[apex:])
        return min(rise, FALL_COUNTS * fall)

    def _beat(self, kept: Sequence[_Kept], top: int) -> Beat:
        sign = self._polarity.sign
        around = range(max(0, top - self._around), min(len(kept), top + self._around // 2 + 1))
        stamp = kept[max(around, key=lambda place: sign * kept[place][1])][0]
        # Interpolated in the filtered signal: its delay hardly changes from beat to beat, while
        # noise would move the flat top of the unfiltered one.
        late = between_samples(*(each[2] for each in kept[top - 1 : top + 2]))
        return Beat(stamp, kept[top][0] + late / self._rate)


def between_samples(before: float, apex: float, after: float) -> float:
    """Return the vertex of the parabola through three samples, relative to the middle one.

    In sampling intervals, from -0.5 to 0.5.
    """
    bend = before - 2 * apex + after
    return min(0.5, max(-0.5, (before - after) / (2 * bend))) if bend else 0.0


class Biquad:
    """A second-order Butterworth filter, sample by sample, in transposed direct form II.

    Coefficients are those of the bilinear transform, as in R. Bristow-Johnson's "Cookbook
    formulae for audio EQ biquad filter coefficients" with Q = 1/sqrt(2).
    """

    def __init__(self, cut_hz: float, rate: float, *, is_high_pass: bool) -> None:
        angle = 2 * math.pi * min(cut_hz, 0.45 * rate) / rate
        cosine, alpha = math.cos(angle), math.sin(angle) / math.sqrt(2)
        side = (1 + cosine) / 2 if is_high_pass else (1 - cosine) / 2
        middle = -2 * side if is_high_pass else 2 * side
        scale = 1 + alpha
        self._b0, self._b1 = side / scale, middle / scale
        self._a1, self._a2 = -2 * cosine / scale, (1 - alpha) / scale
        self._is_high_pass = is_high_pass
        self._s1 = self._s2 = 0.0
        self._is_settled = False

    def take(self, value: float) -> float:
        """Filter the next value, as if the input had been constant before the first one."""
        if not self._is_settled:
            self._is_settled = True
            out = 0.0 if self._is_high_pass else value
            self._s2 = self._b0 * value - self._a2 * out
            self._s1 = self._s2 + self._b1 * value - self._a1 * out
        out = self._b0 * value + self._s1
        self._s1 = self._b1 * value - self._a1 * out + self._s2
        self._s2 = self._b0 * value - self._a2 * out
        return out


class MovingMean:
    """The mean of the last values, or of all values while there are fewer."""

    def __init__(self, length: int) -> None:
        self._length = length
        # nothing is dropped: what a filter slides over
        self._values: deque[float] = deque(maxlen=length)
        self._sum, self._count = 0.0, 0

    def take(self, value: float) -> float:
        """Return the mean with this value."""
        if len(self._values) == self._length:
            self._sum -= self._values[0]
        self._values.append(value)
        self._sum += value
        self._count += 1
        # Summed again from time to time, so that rounding errors do not accumulate.
        if self._count % (16 * self._length) == 0:
            self._sum = math.fsum(self._values)
        return self._sum / len(self._values)


def moment(values: NDArray[np.float64], order: Literal[3, 4]) -> float:
    """Return skewness or kurtosis; 0 for constant values."""
    centred = values - values.mean()
    spread = float(np.sqrt(np.square(centred).mean()))
    if spread <= 0:
        return 0.0
    scaled: NDArray[np.float64] = centred / spread
    squares = np.square(scaled)
    # Not np.power, which takes twenty times as long.
    return float((squares * (scaled if order == 3 else squares)).mean())
