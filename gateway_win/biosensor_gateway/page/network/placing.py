"""Puts the stamps of other computers on this computer's LSL clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LATEST_S, EARLIEST_S = 1.0, 60.0
"""A stamp so far ahead of the arrival, or so far behind it, is of another clock.

Not one of ours: a battery's level waits for its first receiver, with its own stamp.
"""
_DRIFT_S = 2.0

Times = NDArray[np.float64]


class Placer:
    """Places the samples of one stream in time.

    Parameters
    ----------
    is_ours
        Whether an agent of ours stamps them.

    Stamps are those of the sender's LSL clock, corrected by what was measured of that. Without a
    measurement, or where a program stamps by another clock (Unix time for instance), the
    earliest arrival tells where they belong.

    Attributes
    ----------
    correction
        Seconds to add to a stamp; None before the first measurement.
    is_by_arrival
        Whether the newest samples were placed by their arrival.
    """

    def __init__(self, *, is_ours: bool = False) -> None:
        self._earliest_s = np.inf if is_ours else EARLIEST_S
        self.correction: float | None = None
        self.is_by_arrival = False
        self._shift_s: float | None = None
        self._last_s = -np.inf

    def place(self, stamps: Times, now: float) -> Times:
        """Return when samples were measured, in local LSL time; it never runs back.

        Parameters
        ----------
        stamps : shape (n,)
            As they came, anything; n > 0.
        now
            Local LSL time.
        """
        times = stamps if self.correction is None else stamps + self.correction
        self.is_by_arrival = self.correction is None or not self._is_plausible(times, now)
        if self.is_by_arrival:
            times = self._by_arrival(stamps, now)
        if self._last_s > now + LATEST_S:
            self._last_s = -np.inf
        times = np.maximum.accumulate(np.maximum(times, self._last_s))
        self._last_s = float(times[-1])
        return times

    def _by_arrival(self, stamps: Times, now: float) -> Times:
        newest = float(stamps[-1])
        if not np.isfinite(stamps).all() or abs(newest) > 1e15:
            return np.full(len(stamps), now)
        shift = now - newest
        is_new = self._shift_s is None or not 0 <= shift - self._shift_s < _DRIFT_S
        self._shift_s = shift if is_new else self._shift_s
        assert self._shift_s is not None
        return np.clip(stamps + self._shift_s, now - EARLIEST_S, now + LATEST_S)

    def _is_plausible(self, times: Times, now: float) -> bool:
        # Comparisons with NaN are false.
        return bool((times < now + LATEST_S).all() and (times > now - self._earliest_s).all())
