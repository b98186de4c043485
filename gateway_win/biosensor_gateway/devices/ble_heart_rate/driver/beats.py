"""Calculates the times of beats from their intervals, also for packets stored in the strap."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from itertools import accumulate, islice
from typing import NamedTuple

REANCHOR_S = 1.5
"""Intervals are missing when their sum lags this much: no strap delays a beat for longer."""
WINDOW_PACKETS = 32
"""Straps truncate intervals to whole units, so over longer windows the sum would drift."""
NARROW_S = 0.25
"""If a packet comes with every beat, the bounds stay a whole interval apart."""
GAIN = 1 / 4


class BeatClock:
    """A clock that ticks with the intervals between beats.

    The intervals are exact, but their packets arrive about once a second, independently of the
    beats. So beat times are sums of intervals. Each packet bounds the offset between this sum and
    the LSL clock from two sides: its last beat was over when it arrived, and the first beat of the
    next packet was not. The offset is set to the middle if the bounds are narrow, else to the
    upper bound.

    Notes
    -----
    With one packet per second, up to 30 ms late, and 62 to 82 beats per minute, the error is below
    66 ms after 10 s and 41 ms after 30 s (90 % of 100 simulated people), plus the time that the
    strap takes to detect a beat.
    """

    def __init__(self) -> None:
        self._elapsed_s = 0.0
        self._offset_s: float | None = None
        self._arrival_s: float | None = None
        self._upper: deque[float] = deque(maxlen=WINDOW_PACKETS)
        self._lower: deque[float] = deque(maxlen=WINDOW_PACKETS)

    def anchor(self, packets: Iterable[tuple[Sequence[float], float]]) -> None:
        """Begin where the earliest of the first packets puts the beats, however late others are.

        Parameters
        ----------
        packets
            Intervals and arrival of each, as for `place`, which they are still to be given to.
        """
        elapsed_s, uppers = self._elapsed_s, list[float]()
        for intervals_s, arrival_s in packets:
            elapsed_s += sum(intervals_s)
            if intervals_s:
                uppers.append(arrival_s - elapsed_s)
        if uppers:
            self._offset_s = min(uppers)
            self._upper.append(self._offset_s)

    def place(self, intervals_s: Sequence[float], arrival_s: float) -> list[float]:
        """Return the time of the beat at the end of each interval.

        Parameters
        ----------
        intervals_s
            Intervals of one packet in seconds, oldest first; also call this for a packet without
            any.
        arrival_s
            LSL clock when the packet arrived.

        Returns
        -------
        list of float
            LSL times, ascending, none later than the arrival; the first may precede those of the
            previous packet if the clock was moved back.
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
        """Like `place`, for a packet that was stored, so its arrival gives no bounds."""
        self._arrival_s = arrival_s
        self._elapsed_s += sum(intervals_s)
        return walk_back(self._elapsed_s + (self._offset_s or 0.0), intervals_s)

    def _bounded(self, offset_s: float) -> float:
        """Move an offset between its bounds, and towards their middle."""
        upper = min(self._upper)
        # Late packets make the lower bound too high.
        lower = min(upper, max(self._lower, default=upper))
        # For straps that send each beat at once, the upper bound is exact.
        target = (lower + upper) / 2 if upper - lower < NARROW_S else upper
        return min(offset_s + GAIN * (target - offset_s), upper)


def walk_back(last_s: float, intervals_s: Sequence[float]) -> list[float]:
    """Return the end of each interval, given the end of the last one."""
    ages = accumulate(reversed(intervals_s), initial=0.0)
    return [last_s - age for age in islice(ages, len(intervals_s))][::-1]


# A late packet has two possible causes: intervals before it are missing, or it was stored, by the
# strap or by this computer while the agent was not running. To decide, a few packets are held
# back. Stored packets follow each other faster than the heart beats, or their lateness decreases;
# then the beats continue without a gap. Otherwise the clock is anchored again at their arrival.
# The first packets of a connection may have been stored, too, and nothing is known before them:
# they are held back until one arrives that was not.

GROUP = 3
"""Number of packets needed to measure their pace."""
STORED_PACE = 0.5
"""Stored packets arrive within less than this fraction of the duration of their intervals."""
SHRINKS_S = 1.0
"""Minimum decrease in lateness from one group to the next while stored packets arrive."""
HOLD_LIMIT_S = 10.0
MOST_FIRST = 64
"""Most packets held back at the start of a connection."""
TOGETHER_S = 0.3
"""Packets in faster succession were stored, because no heart beats this fast."""
TIMELY_S = 3.0
"""A packet that follows within this time, but not at once, was not stored."""


class Beat(NamedTuple):
    """The end of an interval, and whether the strap considers it valid."""

    interval_s: float
    is_valid: bool = True


class PlacedBeat(NamedTuple):
    """A beat and its LSL time in s."""

    beat: Beat
    time_s: float


class _Packet(NamedTuple):
    beats: Sequence[Beat]
    arrival_s: float

    @property
    def intervals_s(self) -> list[float]:
        return [beat.interval_s for beat in self.beats]


class StoredBeats:
    """Places the beats of one strap, including stored ones; see :class:`.BeatClock`.

    Parameters
    ----------
    holds_first
        Whether the first packets of a connection are held back until one arrives without delay; not
        for a strap whose packets hold the beats of many seconds.
    """

    def __init__(self, *, holds_first: bool = True) -> None:
        self._holds_first = holds_first
        self._clock = BeatClock()
        self._first: list[_Packet] | None = [] if holds_first else None
        self._held: list[_Packet] = []
        self._may_be_stored = False
        self._was_empty = False
        self._arrival_s: float | None = None
        # No packet since the start has been known to arrive without delay.
        self.is_placed_by_arrival = True

    def restart(self) -> list[PlacedBeat]:
        """Start again after a new connection; return the beats held back."""
        released = self._begin()
        if self._held:
            released += self._anchored_again()
        self._clock, self._first = BeatClock(), [] if self._holds_first else None
        self._may_be_stored = self._was_empty = False
        self._arrival_s, self.is_placed_by_arrival = None, True
        return released

    def place(self, beats: Sequence[Beat], arrival_s: float) -> list[PlacedBeat]:
        """Return the beats whose times are certain now, in order; none while unclear.

        Parameters
        ----------
        beats
            Beats of one packet, oldest first; also call this for a packet without any.
        arrival_s
            LSL clock when the packet arrived.
        """
        packet = _Packet(beats, arrival_s)
        before_s, self._arrival_s = self._arrival_s, arrival_s
        is_timely = before_s is not None and TOGETHER_S < arrival_s - before_s < TIMELY_S
        if is_timely:
            self.is_placed_by_arrival = False
        if self._first is None:
            return self._taken(packet)
        is_overdue = bool(self._first) and arrival_s - self._first[0].arrival_s > HOLD_LIMIT_S
        if is_timely or is_overdue or len(self._first) == MOST_FIRST:
            return self._begin() + self._taken(packet)
        self._first.append(packet)
        return []

    def _begin(self) -> list[PlacedBeat]:
        """Place the first packets of a connection in time by the one with the shortest delay."""
        first, self._first = self._first or [], None
        if first:
            self._clock.anchor((each.intervals_s, each.arrival_s) for each in first)
        return [beat for packet in first for beat in self._taken(packet)]

    def _taken(self, packet: _Packet) -> list[PlacedBeat]:
        beats, arrival_s = packet
        # Checked before adding this packet, because its own delay says nothing about the others.
        overdue = bool(self._held) and arrival_s - self._held[0].arrival_s > HOLD_LIMIT_S
        placed = self._anchored_again() if overdue else []
        # A packet without intervals shows that the strap itself missed beats.
        is_told, self._was_empty = self._was_empty, not beats
        if not self._held:
            is_late = bool(beats) and self._late_s(packet) > REANCHOR_S
            self._may_be_stored = is_late and (self._may_be_stored or not is_told)
            if not self._may_be_stored:
                return placed + self._placed(packet)
        if beats:
            self._held.append(packet)
        return placed + self._decided()

    def _decided(self) -> list[PlacedBeat]:
        """Place the packets held back, as far as the cause of their delay is clear."""
        placed: list[PlacedBeat] = []
        while self._held:
            if self._late_s(self._held[0]) <= REANCHOR_S:
                self._may_be_stored = False
                placed += self._placed(self._held.pop(0))
            elif self._is_fast(0) or self._shrinks:
                placed += self._placed(self._held.pop(0), stored=True)
            elif self._is_complete:
                placed += self._anchored_again()
            else:
                break
        return placed

    @property
    def _is_complete(self) -> bool:
        return len(self._held) >= 2 * GROUP

    @property
    def _shrinks(self) -> bool:
        """Whether later packets are less late than the first one, or not late at all."""
        late_s = self._lateness_s()
        if min(late_s) <= REANCHOR_S:
            return True
        if not self._is_complete:
            return False
        change_s = min(late_s[GROUP : 2 * GROUP]) - min(late_s[:GROUP])
        return self._is_fast(GROUP) or abs(change_s) > SHRINKS_S

    def _is_fast(self, begin: int) -> bool:
        """Whether packets arrived so fast that they must have been stored."""
        group = self._held[begin : begin + GROUP]
        if len(group) < GROUP:
            return False
        beaten_s = sum(sum(packet.intervals_s) for packet in group[1:])
        return group[-1].arrival_s - group[0].arrival_s < STORED_PACE * beaten_s

    def _lateness_s(self) -> list[float]:
        """Return how late each packet is, assuming that no intervals are missing."""
        earlier_s, late_s = 0.0, list[float]()
        for packet in self._held:
            late_s.append(self._late_s(packet) - earlier_s)
            earlier_s += sum(packet.intervals_s)
        return late_s

    def _late_s(self, packet: _Packet) -> float:
        return self._clock.late_s(packet.intervals_s, packet.arrival_s)

    def _anchored_again(self) -> list[PlacedBeat]:
        held, self._held = self._held, []
        self._may_be_stored = False
        return [beat for packet in held for beat in self._placed(packet)]

    def _placed(self, packet: _Packet, *, stored: bool = False) -> list[PlacedBeat]:
        put = self._clock.place_stored if stored else self._clock.place
        times = put(packet.intervals_s, packet.arrival_s)
        return [PlacedBeat(*each) for each in zip(packet.beats, times, strict=True)]
