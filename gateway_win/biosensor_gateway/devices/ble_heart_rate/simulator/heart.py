"""Detects the wearer's beats as a strap's own detector does."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from biosensor_gateway.devices.ble_heart_rate.simulator.measurement import RR_TICKS_PER_S
from biosensor_gateway.simulation.oscillator import Oscillator
from biosensor_gateway.simulation.wearer import Wearer

_AVERAGED_INTERVALS = 4


class Interval(NamedTuple):
    """The time between two R peaks.

    Attributes
    ----------
    time
        LSL time of the second peak.
    rr
        Length [1/1024 s of the device's oscillator].
    """

    time: float
    rr: int


class BeatDetector:
    """Finds R peaks and measures the intervals between them.

    The ends of the intervals are rounded, not their lengths, so that the sum over many
    beats stays exact.

    Parameters
    ----------
    oscillator
        Of the device since its power-on.
    origin_s
        LSL time at which the wearer's time is 0.
    begin_s
        LSL time from which beats are looked for.
    """

    def __init__(
        self, wearer: Wearer, oscillator: Oscillator, origin_s: float, begin_s: float
    ) -> None:
        self._wearer = wearer
        self._oscillator = oscillator
        self._origin_s = origin_s
        self._searched_s = begin_s
        self._last_tick: int | None = None
        self._recent: deque[int] = deque(maxlen=_AVERAGED_INTERVALS)

    @property
    def bpm(self) -> int:
        """Rate over the last four intervals [1/min]; 0 until there is one."""
        if not self._recent:
            return 0
        return round(60 * RR_TICKS_PER_S * len(self._recent) / sum(self._recent))

    def search(self, until_s: float) -> list[Interval]:
        """Return the intervals that ended since the last search, oldest first."""
        begin, end = self._searched_s - self._origin_s, until_s - self._origin_s
        self._searched_s = until_s
        intervals: list[Interval] = []
        for beat_s in self._wearer.beats_between(begin, end) + self._origin_s:
            time = float(beat_s)
            tick = int(np.rint(self._oscillator.at(time) * RR_TICKS_PER_S))
            if self._last_tick is not None:
                intervals.append(Interval(time, tick - self._last_tick))
            self._last_tick = tick
        self._recent.extend(interval.rr for interval in intervals)
        return intervals

    def begin_at(self, time_s: float) -> None:
        """Look for no beat before an LSL time, as that at which the device was put on."""
        if time_s > self._searched_s:
            self.lose(time_s)

    def lose(self, until_s: float) -> None:
        """Skip to ``until_s`` without skin contact; the next interval needs two new beats."""
        self._searched_s = until_s
        self._last_tick = None
        self._recent.clear()
