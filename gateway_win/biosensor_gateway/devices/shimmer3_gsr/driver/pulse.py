"""Heart rate from the pulse wave: found beat by beat, with nothing but the past.

Band-pass 0.7 to 4 Hz, peaks above half of the largest in the last 2.5 s, intervals that
fit those before them, median of five. The device sends no heart rate, and the vendor's
software computes its own in a closed library; this is no reconstruction of it.
"""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import NamedTuple

from biosensor_gateway.devices.shimmer3_gsr.driver.filters import HighPass, LowPass

LOW_PASS_HZ = 4.0
HIGH_PASS_HZ = 0.7
PEAK_WINDOW_S = 2.5
PEAK_SHARE = 0.5
SMALLEST_PEAK_MV = 0.5
REFRACTORY_S = 0.30
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


class PulseDetector:
    """Finds beats in a pulse signal that comes in sample by sample.

    A peak's time is that of the filtered wave, 30 ms (at 48 beats a minute) to 53 ms (at
    165) after the one at the finger. Rates up to 200/min can be told.

    Parameters
    ----------
    rate_hz
        Sampling rate, 25 Hz or more.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._intervals: deque[float] = deque(maxlen=INTERVALS_KEPT)
        self._restart()

    def feed(self, time_s: float, millivolts: float) -> HeartRate | None:
        """Take the next sample; return the heart rate if it shows that a beat has happened.

        Parameters
        ----------
        time_s
            Device time, later than that of every sample before.
        millivolts
            The raw signal, with its offset.
        """
        if self._curve and time_s - self._curve[-1][0] > LONGEST_GAP_S:
            self._restart()
        if not self._curve:
            # Else the offset would look like a step.
            self._offset = millivolts
        filtered = self._high_pass.step(self._low_pass.step(millivolts - self._offset))
        self._curve.append((time_s, filtered))
        self._note_largest(time_s, filtered)
        peak_s = self._peak()
        return self._beat(peak_s) if peak_s is not None else None

    def found(self, time_s: float) -> bool:
        """Whether there is a pulse: a heart rate is known, and no beat is missing at this time."""
        return self._has_rate and time_s - self._last_beat_s <= LONGEST_INTERVAL_S

    @property
    def _has_rate(self) -> bool:
        return len(self._intervals) >= BEATS_NEEDED - 1

    def _restart(self) -> None:
        self._low_pass = LowPass(LOW_PASS_HZ, self._rate_hz)
        self._high_pass = HighPass(HIGH_PASS_HZ, self._rate_hz)
        self._offset = 0.0
        self._curve: deque[tuple[float, float]] = deque(maxlen=3)
        self._largest: deque[tuple[float, float]] = deque()
        self._last_beat_s = float("-inf")
        self._misfits = 0
        self._intervals.clear()

    def _note_largest(self, time_s: float, value: float) -> None:
        """Keep the samples that are, or will become, the largest of the window."""
        while self._largest and self._largest[-1][1] <= value:
            self._largest.pop()
        self._largest.append((time_s, value))
        while self._largest[0][0] < time_s - PEAK_WINDOW_S:
            self._largest.popleft()

    def _peak(self) -> float | None:
        """Time of the peak that the last three samples make, between them by a parabola."""
        if len(self._curve) < 3:
            return None
        (_, before), (time_s, middle), (last_s, after) = self._curve
        if not before < middle >= after or time_s - self._last_beat_s < REFRACTORY_S:
            return None
        if middle < max(SMALLEST_PEAK_MV, PEAK_SHARE * self._largest[0][1]):
            return None
        return time_s + (last_s - time_s) * 0.5 * (before - after) / (before - 2 * middle + after)

    def _beat(self, peak_s: float) -> HeartRate | None:
        interval_s = peak_s - self._last_beat_s
        self._last_beat_s = peak_s
        if interval_s > LONGEST_INTERVAL_S:
            self._intervals.clear()
            return None
        if not self._fits(interval_s):
            self._misfits += 1
            if self._misfits >= MISFITS_TOLERATED:
                self._intervals.clear()
            return None
        self._misfits = 0
        self._intervals.append(interval_s)
        return HeartRate(peak_s, 60 / median(self._intervals)) if self._has_rate else None

    def _fits(self, interval_s: float) -> bool:
        if not self._intervals:
            return True
        usual_s = median(self._intervals)
        return abs(interval_s - usual_s) <= MOST_DEVIATION * usual_s
