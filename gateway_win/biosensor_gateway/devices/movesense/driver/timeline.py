"""Places the samples of stamped packets on the device's clock, and counts those that are lost.

A packet is stamped at its first sample, in whole milliseconds. The rate is only about the
nominal one: the movement sensor has an oscillator of its own.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from biosensor_common.clocks import TIMELINE_GAIN

RATE_TOLERANCE = 0.15
WINDOW_PACKETS = 256
"""20 s: a millisecond is 50 ppm of that."""
_TURN_MS = 1 << 32


class Placed(NamedTuple):
    """A packet's place on the device's clock.

    Attributes
    ----------
    times_s
        Device clock of each sample, ascending.
    lost
        Samples missing before them.
    """

    times_s: list[float]
    lost: int


class StampClock:
    """Follows stamps of 32 bits over their roll-over, after 49.7 days."""

    def __init__(self) -> None:
        self._newest_ms: int | None = None

    def read(self, stamp_ms: int) -> float:
        """Return the device's time in seconds; packets may come half a turn late at most."""
        if self._newest_ms is None:
            self._newest_ms = stamp_ms
            return stamp_ms / 1000
        ahead = (stamp_ms - self._newest_ms + _TURN_MS // 2) % _TURN_MS - _TURN_MS // 2
        read_ms = self._newest_ms + ahead
        self._newest_ms = max(self._newest_ms, read_ms)
        return read_ms / 1000

    def forget(self) -> None:
        """Begin anew with the next stamp."""
        self._newest_ms = None


class PacketSeries:
    """Packets of one measurement, followed over restarts and connections.

    Samples are chained by counting, at the rate that the stamps of the last 20 s have; the
    stamps pull the chain only slowly, so that their rounding does not show.

    Parameters
    ----------
    nominal_hz
        Sampling rate that the device was asked for.
    """

    def __init__(self, nominal_hz: float) -> None:
        self._nominal_hz = nominal_hz
        self._nominal_s = 1 / nominal_hz
        self._stamps: deque[tuple[int, float]] = deque(maxlen=WINDOW_PACKETS)
        self._index = 0
        self._next_s: float | None = None
        self._is_new = True
        self._packets = 0

    def restart(self) -> None:
        """Expect a new series of packets, which begins at any moment after the one before."""
        self._is_new = True

    def anew(self) -> PacketSeries:
        """Return one that knows of no packet, for a device that counts anew."""
        return PacketSeries(self._nominal_hz)

    def place(self, stamp_s: float, count: int) -> Placed:
        """Place the next packet.

        Parameters
        ----------
        stamp_s
            Device clock at its first sample.
        count
            Its samples, at least one.
        """
        period_s = self._period_s
        expected_s = stamp_s if self._next_s is None else self._next_s
        lost = self._missing(stamp_s - expected_s, count, period_s)
        expected_s += lost * period_s
        if self._is_new or abs(stamp_s - expected_s) > count * period_s / 2:
            self._stamps.clear()
            self._packets, self._is_new = 0, False
            first_s = stamp_s
        else:
            self._packets += 1
            gain = max(TIMELINE_GAIN, 1 / (1 + self._packets))
            first_s = expected_s + gain * (stamp_s - expected_s)
        self._index += lost
        self._stamps.append((self._index, stamp_s))
        self._index += count
        period_s = self._period_s
        self._next_s = first_s + count * period_s
        return Placed([first_s + at * period_s for at in range(count)], lost)

    def _missing(self, late_s: float, count: int, period_s: float) -> int:
        # Within a series whole packets are lost; where one begins, it is told by time alone.
        unit = 1 if self._is_new else count
        return max(0, round(late_s / (unit * period_s))) * unit

    @property
    def _period_s(self) -> float:
        if len(self._stamps) < 2:
            return self._nominal_s
        (first, first_s), (last, last_s) = self._stamps[0], self._stamps[-1]
        period_s = (last_s - first_s) / (last - first)
        is_likely = abs(period_s / self._nominal_s - 1) <= RATE_TOLERANCE
        return period_s if is_likely else self._nominal_s
