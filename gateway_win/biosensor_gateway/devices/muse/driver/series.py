"""Follows the numbers of packets: which sample is which, and how many are missing."""

from __future__ import annotations

from typing import NamedTuple

from biosensor_common.clocks import PacketTimeline

AHEAD_S = 2.0
"""Numbers may be so far ahead of the time; further, the device counts again."""
AHEAD_SHARE = 0.05


class Place(NamedTuple):
    """Where a packet is among the samples.

    Attributes
    ----------
    first
        Number of its first sample; those of a series follow each other.
    lost
        Samples missing before it.
    is_again
        It is the first one of a series, whose place is told by time alone.
    """

    first: int
    lost: int
    is_again: bool


class PacketSeries:
    """Packets of one stream, over all connections.

    Parameters
    ----------
    modulus
        Number of different packet numbers.
    samples
        In each packet.
    rate_hz
        Nominal.
    """

    def __init__(self, modulus: int, samples: int, rate_hz: float) -> None:
        self._numbers = PacketTimeline(modulus)
        self._samples, self._rate_hz = samples, rate_hz
        self._newest_s: float | None = None
        self._next = 0

    def restart(self) -> None:
        """Expect the device to count again."""
        self._numbers.forget()

    def forget(self) -> None:
        """Take it that the clock which tells the time begins again, too."""
        self._numbers.forget()
        self._newest_s = None

    def place(self, number: int, time_s: float) -> Place:
        """Place a packet.

        Parameters
        ----------
        number
            Its own.
        time_s
            When it came, or was made by the device's clock.
        """
        passed_s = 0.0 if self._newest_s is None else time_s - self._newest_s
        expected = passed_s * self._rate_hz / self._samples
        steps = self._numbers.steps(number, expected)
        ahead = AHEAD_S * self._rate_hz / self._samples + AHEAD_SHARE * abs(expected)
        is_again = steps is None or steps > expected + ahead
        if is_again or steps is None:
            self._numbers.forget()
            self._numbers.place(number)
            lost = 0 if self._newest_s is None else self._missing(passed_s)
        else:
            self._numbers.place(number, expected)
            lost = (steps - 1) * self._samples
        first = self._next + lost
        self._next = first + self._samples
        self._newest_s = time_s
        return Place(first, lost, is_again)

    def _missing(self, passed_s: float) -> int:
        return max(0, round(passed_s * self._rate_hz) - self._samples)
