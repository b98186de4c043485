"""Times of beats of which only the intervals are known, from one packet or stored in the strap."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import accumulate, islice
from typing import NamedTuple

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


# A packet that comes late has two causes, between which it does not tell: intervals before it
# are missing, or it was stored, by the strap or by this computer while the agent got no time.
# So a few packets are held back. Stored ones follow each other faster than a heart beats, or are
# late by less and less; then beats go on where they were. Else the clock is anchored again at
# their arrival.

GROUP = 3
"""So many packets tell how fast they come."""
STORED_PACE = 0.5
"""Stored packets follow each other in less than this part of the time of their intervals."""
SHRINKS_S = 1.0
"""By so much at least the lateness of one group and the next differ while a store empties."""
HOLD_LIMIT_S = 10.0
TOGETHER_S = 0.3
"""No heart beats so fast: packets that follow each other sooner had been stored."""
TIMELY_S = 3.0
"""A packet that follows the one before within this time, and not at once, has not waited."""


class Beat(NamedTuple):
    """The end of an interval, and whether the strap believes in it."""

    interval_s: float
    is_valid: bool = True


class PlacedBeat(NamedTuple):
    """A beat, and when it was on the LSL clock, in s."""

    beat: Beat
    time_s: float


class _Packet(NamedTuple):
    beats: Sequence[Beat]
    arrival_s: float

    @property
    def intervals_s(self) -> list[float]:
        return [beat.interval_s for beat in self.beats]


class StoredBeats:
    """Beats of one strap; see :class:`.beats.BeatClock` for where they are placed.

    Attributes
    ----------
    is_placed_by_arrival
        Since the begin none has shown that it had not waited.
    """

    def __init__(self) -> None:
        self._clock = BeatClock()
        self._held: list[_Packet] = []
        self._may_be_stored = False
        self._was_empty = False
        self._arrival_s: float | None = None
        self.is_placed_by_arrival = True

    def restart(self) -> list[PlacedBeat]:
        """Begin again, as at a new connection; return what was held back."""
        released = self._anchored_again() if self._held else []
        self._clock = BeatClock()
        self._may_be_stored = self._was_empty = False
        self._arrival_s, self.is_placed_by_arrival = None, True
        return released

    def place(self, beats: Sequence[Beat], arrival_s: float) -> list[PlacedBeat]:
        """Return the beats whose place is certain now, in order; none while it is unclear.

        Parameters
        ----------
        beats
            Of one packet, oldest first. A packet without any is to be told as well.
        arrival_s
            LSL clock when the packet arrived.
        """
        packet = _Packet(beats, arrival_s)
        before_s = self._arrival_s
        if before_s is not None and TOGETHER_S < arrival_s - before_s < TIMELY_S:
            self.is_placed_by_arrival = False
        self._arrival_s = arrival_s
        # Before this one is taken in: what held it up is nothing that held up those.
        overdue = bool(self._held) and arrival_s - self._held[0].arrival_s > HOLD_LIMIT_S
        placed = self._anchored_again() if overdue else []
        # A packet without intervals says that the strap itself missed them.
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
        """Place what is held back as far as it is clear what happened."""
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
        """Whether later packets are less late than the first, or not late at all."""
        late_s = self._lateness_s()
        if min(late_s) <= REANCHOR_S:
            return True
        if not self._is_complete:
            return False
        change_s = min(late_s[GROUP : 2 * GROUP]) - min(late_s[:GROUP])
        return self._is_fast(GROUP) or abs(change_s) > SHRINKS_S

    def _is_fast(self, begin: int) -> bool:
        """Whether packets came so fast that they had been stored."""
        group = self._held[begin : begin + GROUP]
        if len(group) < GROUP:
            return False
        beaten_s = sum(sum(packet.intervals_s) for packet in group[1:])
        return group[-1].arrival_s - group[0].arrival_s < STORED_PACE * beaten_s

    def _lateness_s(self) -> list[float]:
        """Return how late each packet is if nothing is missing."""
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
