"""Estimates how much an E4 lost on the radio, which its stamps hide.

The server counts samples and derives their stamps from that count, so what is lost
between wristband and dongle leaves no gap: later stamps merely run late. But the
wristband samples at a known rate, so the samples that should have come in the time
since the first one are known. Delays make that deficit larger for a while, never
smaller; its minimum over a window is what will never come.
"""

from __future__ import annotations

from math import inf

WINDOW_S = 10.0
NOTICEABLE_S = 0.05
"""Below, it may be the way's delays, and is left to the windows to come."""
DRIFT_LIMIT_S = 0.005
"""What a window may lack by drift between the two clocks: 200 ppm make 2 ms of it."""
BRIDGED_S = 60.0
"""After a longer silence nobody knows whether the wristband measured at all."""


class LossEstimate:
    """Follows one regular stream by the arrival of its samples.

    Parameters
    ----------
    rate_hz
        Nominal rate of the stream.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1 / rate_hz
        self._arrival_s: float | None = None
        self.forget()

    def forget(self) -> None:
        """Start over, as when the wristband was switched off."""
        self._first_s: float | None = None
        self._count = 0
        self._accounted_s = 0.0
        self._least_s = inf
        self._window_end_s = inf

    def begin_window(self) -> None:
        """Start a window with the next samples, so that a known gap is told at its end."""
        self._accounted_s = min(self._accounted_s, self._least_s)
        self._least_s = inf
        self._window_end_s = inf

    def take(self, count: int, arrival_s: float) -> float | None:
        """Take in samples; at the end of a window, return the seconds lost in it.

        Parameters
        ----------
        count
            Samples that arrived together.
        arrival_s
            LSL clock at their arrival.
        """
        if self._arrival_s is not None and arrival_s - self._arrival_s > BRIDGED_S:
            self.forget()
        self._arrival_s = arrival_s
        if self._first_s is None:
            self._first_s = arrival_s
        if self._window_end_s == inf:
            self._window_end_s = arrival_s + WINDOW_S
        self._count += count
        deficit_s = arrival_s - self._first_s - self._count * self._period_s
        self._least_s = min(self._least_s, deficit_s)
        if arrival_s < self._window_end_s:
            return None
        return self._close_window(arrival_s)

    def _close_window(self, arrival_s: float) -> float:
        lost_s = self._least_s - self._accounted_s
        self._least_s = inf
        self._window_end_s = arrival_s + WINDOW_S
        if lost_s >= NOTICEABLE_S:
            self._accounted_s += lost_s
            return lost_s
        # A negative loss is a first sample that came late: the base line was too high.
        self._accounted_s += min(lost_s, DRIFT_LIMIT_S)
        return 0.0
