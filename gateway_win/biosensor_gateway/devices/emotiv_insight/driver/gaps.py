"""Samples that are missing between two that arrived, and those that came twice."""

from __future__ import annotations

import math

from biosensor_common.device_clock import LONGEST_DELAY_S

_SET_FORWARD_S = 0.25
"""A sample that comes so much earlier than any before it is stamped by another clock."""
_DELAY_LEAK = 1e-3
"""How fast the least delay is forgotten [s/s]: far faster than any crystal drifts."""
_MAX_BRIDGED_S = 86_400.0
_SAME_MOMENT = 0.5
"""In sampling periods."""


class SampleCount:
    """Follows one stream's counter and time.

    The counter starts over each second, so it hides a loss of whole seconds, and
    the time shows that; the larger of both is what was lost. Where the clock was
    set between two samples, the pause between their arrivals stands in for the time.

    Parameters
    ----------
    rate_hz
        Sampling rate, which is also the modulus of the counter.
    """

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self._counter: int | None = None
        self._time_s: float | None = None
        self._arrival_s = 0.0
        self._least_delay_s = math.inf

    def reconnected(self) -> None:
        """Forget the counter: nothing says that it survives a connection."""
        self._counter = None

    def forget(self) -> None:
        """Start anew, as after the headset was off."""
        self._counter = self._time_s = None
        self._least_delay_s = math.inf

    def lost_before(self, counter: float, time_s: float, arrival_s: float) -> int | None:
        """Take in a sample.

        Parameters
        ----------
        counter
            NaN where the stream has none.
        time_s
            Time of the sample on the device's clock.
        arrival_s
            LSL clock at its arrival.

        Returns
        -------
        int or None
            Samples missing before it; None if it has been here already.
        """
        number = self._usable(counter)
        if self._is_known(number, time_s):
            return None
        lost = 0 if self._time_s is None else self._lost(number, time_s, arrival_s)
        elapsed_s = max(0.0, arrival_s - self._arrival_s)
        self._least_delay_s = min(self._least_delay_s + _DELAY_LEAK * elapsed_s, arrival_s - time_s)
        self._counter, self._time_s, self._arrival_s = number, time_s, arrival_s
        return lost

    @property
    def _modulus(self) -> int:
        return round(self.rate_hz)

    def _usable(self, counter: float) -> int | None:
        # A fractional rate, or a counter beyond it: the modulus is not known.
        if 0 <= counter < self._modulus == self.rate_hz and counter == int(counter):
            return int(counter)
        return None

    def _is_known(self, number: int | None, time_s: float) -> bool:
        if self._time_s is None or time_s > self._time_s:
            return False
        behind = (self._time_s - time_s) * self.rate_hz
        if number is None or self._counter is None:
            return behind < _SAME_MOMENT
        # Further back, the same number is no proof: the clock may have been set by a second.
        return (
            behind < self._modulus / 2 and round(behind) == (self._counter - number) % self._modulus
        )

    def _lost(self, number: int | None, time_s: float, arrival_s: float) -> int:
        by_counter = self._lost_by_counter(number)
        pause_s = arrival_s - self._arrival_s
        if not self._is_clock_set(arrival_s - time_s):
            return max(by_counter, self._periods(time_s - (self._time_s or time_s)) - 1)
        # Arrivals jitter, so they only tell whole seconds.
        hidden = self._periods(pause_s) - 1 - by_counter
        return by_counter + max(0, round(hidden / self._modulus)) * self._modulus

    def _lost_by_counter(self, number: int | None) -> int:
        if number is None or self._counter is None:
            return 0
        return (number - self._counter - 1) % self._modulus

    def _is_clock_set(self, delay_s: float) -> bool:
        later_s = delay_s - self._least_delay_s
        return later_s < -_SET_FORWARD_S or later_s > LONGEST_DELAY_S

    def _periods(self, seconds: float) -> int:
        return round(seconds * self.rate_hz) if seconds <= _MAX_BRIDGED_S else 0
