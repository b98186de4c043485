"""Finds beats that a detector left out, because they are much smaller than those it found.

Every second beat may be small: in bigeminy, in alternans, or where an early beat moves little
blood. A detector with one threshold then gives half of the rate, from a signal without any noise.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.runs import Array, Decimator


class Shape(NamedTuple):
    """What is compared of a beat, and where one can be hidden."""

    rate_hz: float
    around_s: float  # How much of a beat is compared, before and after its apex.
    early_s: float  # So long after a beat another one is possible,
    after_s: float  # so long after it its own waves have ended,
    before_s: float  # and so long before one they begin.
    is_either_way: bool  # Whether a beat may point down.
    order: int  # Of the polynomial that beats lie upon: a level that changes, or a T wave.
    # Whatever is as large as this share of a beat is one, too, after this time; never if NaN.
    other_share: float
    other_after_s: float


class HiddenBeats:
    """Looks between two beats for a smaller one of the same shape.

    Parameters
    ----------
    rate
        Nominal rate in Hz.
    """

    def __init__(self, rate: float, shape: Shape) -> None:
        self._shape = shape
        self._decimator = Decimator(rate, shape.rate_hz)
        slow = self._decimator.rate
        self._around = max(2, round(shape.around_s * slow))
        size = round(at.HIDDEN_KEPT_S * slow)
        # nothing is dropped: what was looked at between two beats
        self._stamps: deque[float] = deque(maxlen=size)
        self._values: deque[float] = deque(maxlen=size)  # nothing is dropped: as the stamps
        # nothing is dropped: a memory of beats
        self._beats: deque[Array] = deque(maxlen=at.PEAKS_KEPT)
        self._last_s = np.nan

    def take(self, stamps: Array, values: Array) -> None:
        """Take samples of one run in; both of shape (n,)."""
        for stamp, value in self._decimator.take(stamps, values):
            self._stamps.append(stamp)
            self._values.append(value)

    def is_before(self, beat_s: float) -> bool | None:
        """Return whether there seems to be a beat between the last one and this one.

        None while it is not known what beats are like.
        """
        last_s, self._last_s = self._last_s, beat_s
        if not beat_s - last_s > self._shape.early_s + self._shape.before_s:
            return False  # nothing is dropped: the first one, or no place for another
        stamps, values = np.array(self._stamps), np.array(self._values)
        width = 2 * self._around + 1
        if len(values) < width:
            return None
        plain = np.lib.stride_tricks.sliding_window_view(values, width)
        windows = _straightened(plain, self._shape.order)
        middles = stamps[self._around : len(stamps) - self._around]
        # The sample that is nearest to the beat before.
        place = int(np.abs(middles - last_s).argmin())
        if middles[0] < last_s:
            self._beats.append(windows[place])
        if len(self._beats) < at.TEMPLATE_LEAST:
            return None
        beat = np.median(list(self._beats), axis=0)
        size = float(np.sqrt(np.square(beat).sum()))
        until = middles < beat_s - self._shape.before_s
        if not size > 0:
            return False
        # The slower a heart, the later the waves of its beats.
        later = math.sqrt(max(1.0, (beat_s - last_s) / at.HIDDEN_SLOW_S))
        is_here = (middles > last_s + later * self._shape.early_s) & until
        here, is_early = windows[is_here], middles[is_here] < last_s + later * self._shape.after_s
        sizes = np.sqrt(np.square(here).sum(axis=1))
        alike = here @ beat / size / np.maximum(sizes, 1e-9 * size)
        if self._shape.is_either_way:
            alike = np.abs(alike)
        else:
            # It has a top, which the slope behind another wave has not.
            near = slice(self._around // 2, width - self._around // 2)
            middle = plain[is_here, near]
            alike[middle.max(axis=1) <= np.maximum(middle[:, 0], middle[:, -1])] = 0.0
        early = at.HIDDEN_EARLY_ALIKE if self._is_narrow(beat) else np.inf
        least = np.where(is_early, early, at.HIDDEN_ALIKE)
        is_like = (sizes >= at.HIDDEN_SHARE * size) & (alike >= least)
        # Wide beats, as of the ventricles, differ little from the bow of a T wave.
        other = _straightened(plain[(middles > last_s + self._shape.other_after_s) & until], 1)
        is_large = np.ptp(other, axis=1) > self._shape.other_share * np.ptp(beat)
        return bool(is_like.any() or is_large.any())

    def _is_narrow(self, beat: Array) -> bool:
        near = max(1, round(at.NARROW_S * self._decimator.rate))
        inside = beat[self._around - near : self._around + near + 1]
        return bool(np.square(inside).sum() >= at.NARROW_SHARE * np.square(beat).sum())


def _straightened(windows: Array, order: int) -> Array:
    """Return windows without the polynomial that is nearest to them; shape (n, width)."""
    line = np.linspace(-1.0, 1.0, windows.shape[1])
    base, _ = np.linalg.qr(np.vander(line, order + 1))
    return windows - windows @ base @ base.T


ECG_SHAPE = Shape(
    rate_hz=at.TEMPLATE_RATE_HZ,
    around_s=0.08,
    early_s=0.25,
    after_s=0.4,
    before_s=0.25,
    is_either_way=True,
    order=2,
    other_share=0.4,
    other_after_s=0.5,
)
"""A T wave is over after 0.4 s, or has another shape than a QRS complex; a P wave begins up to
0.25 s before one."""
PPG_SHAPE = Shape(
    rate_hz=50.0,
    around_s=0.2,
    early_s=0.48,
    after_s=0.48,
    before_s=0.35,
    is_either_way=False,
    order=1,
    other_share=np.nan,
    other_after_s=0.48,
)
"""The second wave of a pulse is 0.3 to 0.45 s after the first."""
