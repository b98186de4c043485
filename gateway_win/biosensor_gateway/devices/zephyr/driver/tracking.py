"""Places samples on the device's clock: gaps, beats, even spacing."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from biosensor_common.clocks import PacketTimeline, SampleTimeline
from biosensor_common.device_clock import LONGEST_DELAY_S
from biosensor_gateway.devices.zephyr.driver.messages import Header, RrIntervals

_SEQUENCE_MODULUS = 256
# In bad contact the device reports intervals from 24 to 12 498 ms.
_RR_RANGE_MS = range(250, 1501)
_MAX_BRIDGED_S = 86_400.0
_REMEMBERED = 16
_USUALLY_LATE_S = 5.0
"""Where a device has no clock, numbers that claim a longer gap than arrivals leave room for,
by more than this, were begun anew."""


@dataclass(frozen=True, slots=True)
class Placed:
    """A packet's place on the device's clock.

    Attributes
    ----------
    stamp_s
        The packet's own stamp.
    first_s
        Time of its first sample when samples are evenly spaced.
    lost_packets
        Packets lost before it.
    """

    stamp_s: float
    first_s: float
    lost_packets: int


class PacketTrack:
    """One kind of periodic packet, followed over connections.

    What a packet's stamp says decides; its number confirms it, and tells a gap from a clock
    that was set. So numbers that are begun anew, or stand still, make no gap.

    Parameters
    ----------
    samples
        Samples in a packet.
    period_s
        Sampling period in seconds.
    stamped_at_end
        The stamp is that of the moment when the packet is complete, not of its
        first sample.
    """

    def __init__(self, samples: int, period_s: float, *, stamped_at_end: bool = False) -> None:
        self.samples = samples
        self._duration_s = samples * period_s
        self._period_s = period_s
        self._age_s = 0.0 if stamped_at_end else self._duration_s
        self._timeline = SampleTimeline(period_s)
        self._numbers = PacketTimeline(_SEQUENCE_MODULUS)
        self._stamped: deque[Header] = deque(maxlen=_REMEMBERED)
        self._next_s: float | None = None
        self._arrival_s = 0.0

    def reconnected(self) -> None:
        """Forget the sequence number: nothing says that it survives a connection."""
        self._numbers.forget()

    def place(self, header: Header, arrival_s: float) -> Placed | None:
        """Place the next packet on the device's clock; None for one that came before.

        A device whose clock was never set counts from the arrival of a connection's
        first packet instead.
        """
        if self._came_before(header, arrival_s):
            return None
        stamp = header.device_s
        if stamp is None:
            stamp = self._counted_stamp(header.sequence, arrival_s)
        else:
            self._stamped.append(header)
        lost = self._lost(header.sequence, stamp, arrival_s)
        self._numbers.place(header.sequence)
        first = self._timeline.place(stamp, self.samples, lost * self.samples)
        self._arrival_s = arrival_s
        self._next_s = first + self._duration_s
        return Placed(stamp, first, lost)

    def times(self, first_s: float) -> list[float]:
        """Device time of each sample of a packet."""
        return [first_s + index * self._period_s for index in range(self.samples)]

    def _came_before(self, header: Header, arrival_s: float) -> bool:
        if header.device_s is not None:
            return header in self._stamped
        is_same = self._numbers.steps(header.sequence, 0.0, None) == 0
        return is_same and arrival_s - self._arrival_s < self._duration_s / 2

    def _counted_stamp(self, sequence: int, arrival_s: float) -> float:
        steps = self._numbers.steps(sequence)
        if steps is None or self._next_s is None:
            return arrival_s - self._age_s
        missing_s = (steps - 1) * self._duration_s
        pause_s = self._pause_s(arrival_s)
        if missing_s > pause_s + _USUALLY_LATE_S:
            missing_s = max(0, round(pause_s / self._duration_s)) * self._duration_s
        return self._next_s + missing_s

    def _lost(self, sequence: int, stamp_s: float, arrival_s: float) -> int:
        by_time = self._lost_by_time(stamp_s, arrival_s)
        is_next = self._numbers.steps(sequence) == 1
        # The very next number, but another time: the device's clock was set.
        return 0 if is_next and by_time % _SEQUENCE_MODULUS else by_time

    def _lost_by_time(self, stamp_s: float, arrival_s: float) -> int:
        if self._next_s is None:
            return 0
        missing_s = stamp_s - self._next_s
        pause_s = self._pause_s(arrival_s)
        if abs(missing_s - pause_s) > LONGEST_DELAY_S:
            # The device's clock was set meanwhile; only the host's knows how long it took.
            missing_s = pause_s
        if missing_s > _MAX_BRIDGED_S:
            return 0
        return max(0, round(missing_s / self._duration_s))

    def _pause_s(self, arrival_s: float) -> float:
        """Return how much longer than a packet it is since the last one came."""
        return arrival_s - self._arrival_s - self._duration_s


class BeatDetector:
    """Finds new beats in R-R packets: a beat is where the reading changes.

    The first reading after a start or a gap is no beat: it may be long past.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def reset(self) -> None:
        """Forget the last reading, as after lost packets."""
        self._last = None

    def beats(self, packet: RrIntervals) -> list[tuple[int, float]]:
        """Return (index of the reading, R-R interval in s) of each plausible new beat."""
        found: list[tuple[int, float]] = []
        for index, reading in enumerate(packet.samples):
            if self._last is not None and reading != self._last and abs(reading) in _RR_RANGE_MS:
                found.append((index, abs(reading) / 1000))
            self._last = reading
        return found
