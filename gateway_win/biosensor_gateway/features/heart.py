"""Computes heart rate and heart-rate variability from beats."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from statistics import median
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.runs import Array, Event

NOTHING = math.nan
HR_QUALITY = "hr_live_quality"


class Variability(NamedTuple):
    """Heart-rate variability of one window."""

    # rmssd_ms, sdnn_ms, pnn50_percent: by the Task Force's definitions, SDNN with n - 1; NaN with
    # fewer than two intervals, or without two neighbouring ones.
    rmssd_ms: float
    sdnn_ms: float
    pnn50_percent: float


def variability(intervals_s: Array, is_valid: NDArray[np.bool_]) -> Variability:
    """Return the variability of intervals between beats.

    Parameters
    ----------
    intervals_s : ndarray of float64, shape (n,)
    is_valid : ndarray of bool, shape (n,)
        Invalid intervals are left out, and no difference is taken across them.
    """
    valid = intervals_s[is_valid]
    steps = np.diff(intervals_s)[is_valid[1:] & is_valid[:-1]]
    sdnn = float(valid.std(ddof=1)) * 1e3 if len(valid) > 1 else NOTHING
    if not len(steps):
        return Variability(NOTHING, sdnn, NOTHING)
    rmssd = math.sqrt(float(np.mean(steps * steps))) * 1e3
    # A margin, so that a step of exactly 50 ms is not counted because of rounding.
    count = int(np.count_nonzero(np.abs(steps) > at.NN50_S + 1e-9))
    return Variability(rmssd, sdnn, 100 * count / len(valid))


def is_artefact(interval_s: float, before_s: float) -> bool:
    """Whether an interval is an artefact by Malik's rule.

    `before_s` is the previous interval, NaN if there is none.
    """
    low, high = at.INTERVAL_S
    changes = abs(interval_s - before_s) > at.INTERVAL_CHANGE * before_s
    return not low <= interval_s <= high or changes


class _Interval(NamedTuple):
    stamp: float
    length_s: float
    is_valid: bool
    hides_beat: bool | None
    is_usable: bool = True


class Trust(Protocol):
    """Quality of the signal that contains the beats."""

    def worst(self, begin_s: float, end_s: float) -> float:
        """Return the lowest quality of the windows between two stamps; NaN if there is none."""
        ...


class Heart:
    """Computes `beats`, `hr_live`, `hr_live_quality` and `hrv_live` from the beats of one run.

    Windows end with a beat. A window gives nothing before it is full, and NaN if too few of its
    intervals are valid. The motion channel is NaN; `Beside` fills it in.

    Parameters
    ----------
    trust
        Quality of the signal; None for intervals that a device reports, which are trusted.
    """

    def __init__(self, trust: Trust | None = None) -> None:
        self._trust = trust
        self._kept: deque[_Interval] = deque()
        self._begin: float | None = None
        self._stamp = self._before = NOTHING
        self._is_first = False

    def beat(
        self, stamp: float, interval_s: float | None = None, *, hides_beat: bool | None = False
    ) -> list[Event]:
        """Take a beat, and return its events.

        Parameters
        ----------
        stamp
            Of its apex; later than the previous one.
        interval_s
            Since the previous beat, NaN if there is none; None to compute it from the stamps.
        hides_beat
            Whether there seems to be a beat in between that was left out; None if unknown.
        """
        if interval_s is None:
            interval_s = stamp - self._stamp
        self._stamp = stamp
        if math.isnan(interval_s):
            if self._begin is None:
                self._begin = stamp
            return [Event("beats", stamp, (NOTHING, 0.0))]
        if self._begin is None:
            self._begin = stamp - interval_s
        wrong = bool(hides_beat) or is_artefact(interval_s, self._before)
        if wrong and self._is_first:
            # Nothing came before the last one to judge it by, and they differ: either may be wrong.
            self._kept[-1] = self._kept[-1]._replace(is_valid=False, is_usable=False)
        self._is_first = math.isnan(self._before)
        self._before = interval_s
        self._kept.append(_Interval(stamp, interval_s, not wrong, hides_beat))
        while self._kept[0].stamp <= stamp - max(at.HRV_WINDOWS_S):
            self._kept.popleft()
        events = [Event("beats", stamp, (interval_s, float(wrong)))]
        return events + self._rate() + self._variability()

    def forget(self, seconds: float) -> None:
        """Forget the intervals of the last seconds, which may not be those of the heart."""
        since = self._stamp - seconds
        # nothing is dropped: hr_live_quality says how few are left
        self._kept = deque(each for each in self._kept if each.stamp <= since)
        self._before = NOTHING
        self._is_first = False

    def _quality(self, window_s: float) -> float:
        """Return the signal's quality in a window that ends now; NaN if unknown."""
        if self._trust is None:
            return NOTHING
        return self._trust.worst(self._stamp - window_s, self._stamp)

    def _rate(self) -> list[Event]:
        """Return the rate from the valid intervals, or from all if too few are valid."""
        window_s = at.HR_WINDOW_S
        last = [each for each in self._kept if each.stamp > self._stamp - window_s]
        valid = [each for each in last if each.is_valid]
        low, high = at.RATE_INTERVAL_S
        taken = _usual(valid)
        quality = self._quality(window_s + at.HR_QUALITY_AGE_S)
        few = min(at.HR_FEW_INVALID, at.HR_FEW_SHARE * len(last))
        if len(last) - len(valid) > max(few, (1 - at.HR_VALID_SHARE) * len(last)):
            # Either the rhythm is irregular, and the valid intervals would be a biased choice; or
            # the signal is bad, and none can be used.
            is_good = self._trust is None or quality >= at.GOOD_QUALITY
            usable = [each for each in last if is_good and each.is_usable]
            taken = [each for each in usable if low <= each.length_s <= high]
        if len(taken) < at.HR_LEAST:
            return []  # nothing is dropped: hr_live_quality says how few there are
        rate = _rate_of(taken)
        covered = _covered(taken, self._stamp, window_s)
        judged = [each.hides_beat for each in last if each.hides_beat is not None]
        hidden = sum(judged)
        hides_some = hidden >= min(at.HIDDEN_LEAST, max(1.0, at.HIDDEN_PART * len(judged)))
        is_apart = abs(_rate_of(last) - rate) > at.HR_APART_PER_MIN
        if is_apart or hides_some or _leaves_out(last):
            # A heart that paused, or beats that were missed or invented: no interval tells which.
            quality = min(quality, at.HR_APART_QUALITY) if quality >= 0 else quality
        beside = (float(len(taken)), len(valid) / len(last), covered, quality, NOTHING)
        return [
            Event("hr_live", self._stamp, (rate,)),
            Event(HR_QUALITY, self._stamp, beside),
        ]

    def _variability(self) -> list[Event]:
        assert self._begin is not None
        if self._stamp - self._begin < min(at.HRV_WINDOWS_S):
            return []  # nothing is dropped: the first window is not full yet
        values: list[float] = []
        beside: list[float] = []
        for window_s in at.HRV_WINDOWS_S:
            if self._stamp - self._begin < window_s:
                values += [NOTHING] * 4
                beside += [NOTHING] * 4
                continue  # nothing is dropped: the window is not full yet, and NaN says so
            last = [each for each in self._kept if each.stamp > self._stamp - window_s]
            valid = [each for each in last if each.is_valid]
            share, covered = len(valid) / len(last), _covered(valid, self._stamp, window_s)
            found = Variability(NOTHING, NOTHING, NOTHING)
            if min(share, covered) >= at.HRV_LEAST_SHARE:
                intervals = np.array([each.length_s for each in last])
                found = variability(intervals, np.array([each.is_valid for each in last]))
            values += [*found, share]
            beside += [float(len(valid)), covered, self._quality(window_s), NOTHING]
        return [Event("hrv_live", self._stamp, (*values, *beside))]


def _rate_of(intervals: Sequence[_Interval]) -> float:
    return 60 * len(intervals) / math.fsum(each.length_s for each in intervals)


def _leaves_out(intervals: Sequence[_Interval]) -> bool:
    """Whether intervals are all usual but some, which are twice as long, as where beats are missed.

    An early beat is followed by a pause, so that both together are two usual intervals.
    """
    middle = median(each.length_s for each in intervals)
    parts = [each.length_s / middle for each in intervals]
    usual = sum(abs(each - 1) < at.HR_ONCE for each in parts)
    twice = sum(abs(each - 2) < at.HR_TWICE for each in parts)
    return twice > 0 and usual >= at.HR_ONCE_SHARE * len(parts) and usual + twice == len(parts)


def _usual(intervals: Sequence[_Interval]) -> list[_Interval]:
    """Return the intervals that are not far from their median."""
    middle = median([each.length_s for each in intervals] or [NOTHING])
    most = at.HR_USUAL_TIMES
    # nothing is dropped: hr_live_quality says how many are left
    return [each for each in intervals if middle / most <= each.length_s <= middle * most]


def _covered(intervals: Sequence[_Interval], end_s: float, window_s: float) -> float:
    """Return the share of a window's time that the intervals cover."""
    begin_s = end_s - window_s
    inside = (min(each.length_s, each.stamp - begin_s) for each in intervals)
    return min(1.0, math.fsum(inside) / window_s)
