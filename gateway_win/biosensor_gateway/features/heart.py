"""Makes heart rate and heart-rate variability of beats."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.runs import Array, Event

NOTHING = math.nan


class Variability(NamedTuple):
    """Of one window.

    Attributes
    ----------
    rmssd_ms, sdnn_ms, pnn50_percent
        By the Task Force's definitions, with n - 1 under SDNN; NaN without two intervals, or
        without two neighbours of them.
    """

    rmssd_ms: float
    sdnn_ms: float
    pnn50_percent: float


def variability(intervals_s: Array, is_valid: NDArray[np.bool_]) -> Variability:
    """Return the variability of intervals between beats.

    Parameters
    ----------
    intervals_s : ndarray of float64, shape (n,)
    is_valid : ndarray of bool, shape (n,)
        What is not is left out, and no difference is taken across it.
    """
    valid = intervals_s[is_valid]
    steps = np.diff(intervals_s)[is_valid[1:] & is_valid[:-1]]
    sdnn = float(valid.std(ddof=1)) * 1e3 if len(valid) > 1 else NOTHING
    if not len(steps):
        return Variability(NOTHING, sdnn, NOTHING)
    rmssd = math.sqrt(float(np.mean(steps * steps))) * 1e3
    # A step of exactly 50 ms is none, however its last bit was rounded.
    share = float(np.mean(np.abs(steps) > at.NN50_S + 1e-9))
    return Variability(rmssd, sdnn, share * 100)


def is_artefact(interval_s: float, before_s: float) -> bool:
    """Whether an interval is not one between normal beats, by Malik's rule.

    `before_s` is the interval before it, NaN where there is none.
    """
    low, high = at.INTERVAL_S
    changes = abs(interval_s - before_s) > at.INTERVAL_CHANGE * before_s
    return not low <= interval_s <= high or changes


class _Interval(NamedTuple):
    stamp: float
    length_s: float
    is_valid: bool


class Heart:
    """Takes beats of one run; gives `beats`, `hr_live` and `hrv_live`.

    Windows go by the times of the beats. A window gives nothing before it is full, and NaN where
    too few of its intervals are valid.
    """

    def __init__(self) -> None:
        self._kept: deque[_Interval] = deque()
        self._begin: float | None = None
        self._stamp = self._before = NOTHING

    def beat(self, stamp: float, interval_s: float | None = None) -> list[Event]:
        """Take a beat in.

        Parameters
        ----------
        stamp
            Of its apex, after that of the one before.
        interval_s
            Since the one before, if the device says so; else from the stamps.
        """
        if interval_s is None:
            interval_s = stamp - self._stamp
        self._stamp = stamp
        if math.isnan(interval_s):
            self._begin = stamp
            return [Event("beats", stamp, (NOTHING, 0.0))]
        if self._begin is None:
            self._begin = stamp - interval_s
        wrong = is_artefact(interval_s, self._before)
        self._before = interval_s
        self._kept.append(_Interval(stamp, interval_s, not wrong))
        while self._kept[0].stamp <= stamp - max(at.HRV_WINDOWS_S):
            self._kept.popleft()
        events = [Event("beats", stamp, (interval_s, float(wrong)))]
        return events + self._rate() + self._variability()

    def _rate(self) -> list[Event]:
        valid: list[float] = []
        for each in reversed(self._kept):
            if each.stamp <= self._stamp - at.HR_WINDOW_S:
                break
            if each.is_valid:
                valid.append(each.length_s)
        if len(valid) < at.HR_LEAST:
            return []
        return [Event("hr_live", self._stamp, (60 * len(valid) / math.fsum(valid),))]

    def _variability(self) -> list[Event]:
        assert self._begin is not None
        if self._stamp - self._begin < min(at.HRV_WINDOWS_S):
            return []
        stamps = np.array([each.stamp for each in self._kept])
        intervals = np.array([each.length_s for each in self._kept])
        is_valid = np.array([each.is_valid for each in self._kept])
        values: list[float] = []
        for window_s in at.HRV_WINDOWS_S:
            if self._stamp - self._begin < window_s:
                values += [NOTHING] * 4
                continue
            first = int(np.searchsorted(stamps, self._stamp - window_s, side="right"))
            share = float(np.mean(is_valid[first:]))
            found = variability(intervals[first:], is_valid[first:])
            if share < at.HRV_LEAST_SHARE:
                found = Variability(NOTHING, NOTHING, NOTHING)
            values += [*found, share]
        return [Event("hrv_live", self._stamp, tuple(values))]
