"""Heart rate from the pulse wave, beat by beat, with nothing but the past.

Pulses are those of live features; intervals that fit those before them, median of five. The device
sends no heart rate, and the vendor's software computes its own in a closed library; this is no
reconstruction of it.
"""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import NamedTuple

from biosensor_gateway.pulses.finding import Pulses

SMALLEST_PEAK_MV = 0.5
LONGEST_INTERVAL_S = 2.0
MOST_DEVIATION = 0.35
BEATS_NEEDED = 5
INTERVALS_KEPT = 5
MISFITS_TOLERATED = 3
"""So many misfits in a row, and it is the intervals before that were wrong."""
LONGEST_GAP_S = 0.25
"""After a longer hole in the signal a beat may be missing, so counting starts anew."""


class HeartRate(NamedTuple):
    """Heart rate at a beat: device time of the pulse wave's peak [s], and its value [1/min]."""

    time_s: float
    bpm: float


class PulseRate:
    """Tells the heart rate of a pulse signal that comes in sample by sample.

    A peak's time is that of the filtered wave, 40 ms before (at 35 beats a minute) to 20 ms after
    (at 165) the one at the finger. Rates up to 200/min can be told.

    Parameters
    ----------
    rate_hz
        Sampling rate, 25 Hz or more.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._intervals: deque[float] = deque(maxlen=INTERVALS_KEPT)
        self._restart()

    def feed(self, time_s: float, millivolts: float) -> list[HeartRate]:
        """Take the next sample; return the heart rate at each beat that it shows.

        Parameters
        ----------
        time_s
            Device time, later than that of every sample before.
        millivolts
            The raw signal, with its offset.
        """
        if time_s - self._latest_s > LONGEST_GAP_S:
            self._restart()
        self._latest_s = time_s
        found = self._pulses.take(time_s, millivolts)
        if self._pulses.height < SMALLEST_PEAK_MV:
            return []
        return [rate for beat in found for rate in self._beat(beat.apex_s)]

    def found(self, time_s: float) -> bool:
        """Whether there is a pulse: a heart rate is known, and no beat is missing at this time."""
        return self._has_rate and time_s - self._last_beat_s <= LONGEST_INTERVAL_S

    @property
    def _has_rate(self) -> bool:
        return len(self._intervals) >= BEATS_NEEDED - 1

    def _restart(self) -> None:
        self._pulses = Pulses(self._rate_hz)
        self._latest_s = self._last_beat_s = float("-inf")
        self._misfits = 0
        self._intervals.clear()

    def _beat(self, peak_s: float) -> list[HeartRate]:
        interval_s = peak_s - self._last_beat_s
        self._last_beat_s = peak_s
        if interval_s > LONGEST_INTERVAL_S:
            self._intervals.clear()
            return []
        if not self._fits(interval_s):
            self._misfits += 1
            if self._misfits >= MISFITS_TOLERATED:
                self._intervals.clear()
            return []
        self._misfits = 0
        self._intervals.append(interval_s)
        return [HeartRate(peak_s, 60 / median(self._intervals))] if self._has_rate else []

    def _fits(self, interval_s: float) -> bool:
        if not self._intervals:
            return True
        usual_s = median(self._intervals)
        return abs(interval_s - usual_s) <= MOST_DEVIATION * usual_s
