"""Reckons the times of beats of which only the intervals are known."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import accumulate, islice

REANCHOR_S = 1.5
"""Intervals are missing when their sum falls so far behind: no strap keeps a beat for longer."""
WINDOW_PACKETS = 32
"""Straps cut intervals to whole units: in longer windows the sum would slip by itself."""
NARROW_S = 0.25
"""Packets that come with every beat leave the bounds a whole interval apart."""
GAIN = 1 / 4


class BeatClock:
    """A clock that ticks with the intervals between beats.

    The intervals are exact, but their packets come about once a second, whenever the
    heart beats. So beats are placed by adding intervals up. Where that sum lies on the
    LSL clock is bounded by every packet from two sides: its last beat was over when it
    arrived, and the first beat of the next packet was not. It is taken to be in the
    middle where the bounds are narrow, else at the upper one.

    Notes
    -----
    With a packet a second, up to 30 ms late, and 62 to 82 beats a minute, beats are
    placed within 66 ms after 10 s and 41 ms after 30 s (90 % of 100 simulated people),
    later than they were by however long the strap takes to detect a beat.
    """

    def __init__(self) -> None:
        self._elapsed_s = 0.0
        self._offset_s: float | None = None
        self._arrival_s: float | None = None
        self._upper: deque[float] = deque(maxlen=WINDOW_PACKETS)
        self._lower: deque[float] = deque(maxlen=WINDOW_PACKETS)

    def place(self, intervals_s: Sequence[float], arrival_s: float) -> list[float]:
        """Return when the beat at the end of each interval happened.

        Parameters
        ----------
        intervals_s
            Intervals of one packet in seconds, oldest first. A packet without any is
            to be told as well.
        arrival_s
            LSL clock when the packet arrived.

        Returns
        -------
        list of float
            LSL times, ascending, none later than the arrival; the first may precede
            those of the packet before where the clock was moved back.
        """
        before_s, self._arrival_s = self._arrival_s, arrival_s
        if not intervals_s:
            return []
        first_s = self._elapsed_s + intervals_s[0]
        self._elapsed_s += sum(intervals_s)
        upper = arrival_s - self._elapsed_s
        if self._offset_s is None or upper - self._offset_s > REANCHOR_S:
            self._upper.clear()
            self._lower.clear()
            self._offset_s = upper
        elif before_s is not None:
            self._lower.append(before_s - first_s)
        self._upper.append(upper)
        self._offset_s = self._bounded(self._offset_s)
        return walk_back(self._elapsed_s + self._offset_s, intervals_s)

    def late_s(self, intervals_s: Sequence[float], arrival_s: float) -> float:
        """Return how long after its last beat the next packet arrived; 0 for the first."""
        if self._offset_s is None:
            return 0.0
        return arrival_s - self._elapsed_s - sum(intervals_s) - self._offset_s

    def place_stored(self, intervals_s: Sequence[float], arrival_s: float) -> list[float]:
        """Return what `place` does of a packet that waited, and so bounds nothing."""
        self._arrival_s = arrival_s
        self._elapsed_s += sum(intervals_s)
        return walk_back(self._elapsed_s + (self._offset_s or 0.0), intervals_s)

    def _bounded(self, offset_s: float) -> float:
        """Move an offset between its bounds, and on towards their middle."""
        upper = min(self._upper)
        # Packets that were late make too high a lower bound.
        lower = min(upper, max(self._lower, default=upper))
        # Straps that send each beat at once are always at the upper bound.
        target = (lower + upper) / 2 if upper - lower < NARROW_S else upper
        return min(offset_s + GAIN * (target - offset_s), upper)


def walk_back(last_s: float, intervals_s: Sequence[float]) -> list[float]:
    """Return the end of each interval, given the end of the last one."""
    ages = accumulate(reversed(intervals_s), initial=0.0)
    return [last_s - age for age in islice(ages, len(intervals_s))][::-1]
