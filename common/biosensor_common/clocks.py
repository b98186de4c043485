"""Unwraps packet numbers, smooths packet times and keeps stamps monotonic.

The other clock arithmetic: `biosensor_common.device_clock` maps a device's clock to
the LSL clock, `biosensor_common.ros_clock` the LSL clock to ROS time. None of it
reads a clock.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

TIMELINE_GAIN = 1 / 16
TIMELINE_TOLERANCE_S = 0.020
"""In recordings, stamps strayed up to 8 ms from the chain; a miscounted packet makes 250 ms."""

MONOTONIC_STEP_S = 1e-6
"""Still distinct as a float on any LSL clock and after rounding to ROS nanoseconds."""


class PacketTimeline:
    """Unwraps the packet numbers of a device over roll-overs and gaps.

    A number is known only modulo its range. Of all step counts that it allows, the one nearest
    to the number of packets expected from the elapsed time is taken.

    Parameters
    ----------
    modulus : int
        Number of different numbers: 256 for one byte.

    Attributes
    ----------
    newest : int or None
        Count of the newest packet, without roll-overs; None before the first.
    """

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self.newest: int | None = None

    def steps(self, number: int, expected: float = 1.0, least: int | None = 1) -> int | None:
        """Return by how many packets this one follows the newest one: 1 if nothing is missing.

        Parameters
        ----------
        expected : float
            Number of packets expected from the elapsed time.
        least : int or None
            Smallest possible step; None if packets may arrive late or twice.

        Returns
        -------
        int or None
            None before the first packet.

        Raises
        ------
        ValueError
            If `number` is outside ``0 .. modulus - 1``.
        """
        if not 0 <= number < self._modulus:
            raise ValueError(f"packet number {number} is outside 0..{self._modulus - 1}")
        if self.newest is None:
            return None
        base = least or 0
        steps = base + (number - self.newest - base) % self._modulus
        turns = round((expected - steps) / self._modulus)
        return steps + (turns if least is None else max(0, turns)) * self._modulus

    def place(self, number: int, expected: float = 1.0, least: int | None = 1) -> int | None:
        """Return the same as `steps`, and make this packet the newest one."""
        steps = self.steps(number, expected, least)
        self.newest = number if self.newest is None or steps is None else self.newest + steps
        return steps

    def forget(self) -> None:
        """Start again with the next packet."""
        self.newest = None


class SampleTimeline:
    """Device times of regular samples whose packets carry jittering stamps.

    Samples are chained by counting; the stamps only pull the chain slowly, so that
    a sampling clock which drifts against the stamping clock is followed. Where
    chain and stamp disagree by more than 20 ms (half a period, if that is more), a
    loss was miscounted or the clock was set, and the chain starts again at the stamp.

    Notes
    -----
    The gain falls as 1/k to 1/16 (a running mean first, then exponential
    smoothing). Stamps that jitter uniformly by 2 ms then leave 0.2 ms RMS; a drift
    of 200 ppm makes a constant lag, 3.2 ms at one packet a second, 0.8 ms at four.

    Parameters
    ----------
    period_s : float
        Sampling period in seconds, positive.

    Raises
    ------
    ValueError
        If `period_s` is not positive and finite.
    """

    def __init__(self, period_s: float) -> None:
        if not (math.isfinite(period_s) and period_s > 0.0):
            raise ValueError(f"a sampling period must be positive, not {period_s}")
        self._period = period_s
        self._tolerance = max(TIMELINE_TOLERANCE_S, period_s / 2)
        self._next: float | None = None
        self._packets = 0
        self._reanchors = 0

    @property
    def reanchors(self) -> int:
        """How often the chain was restarted at a stamp."""
        return self._reanchors

    def place(self, stamp_s: float, n: int, lost: int = 0) -> float:
        """Return the device time of a packet's first sample; sample k follows at k periods.

        Parameters
        ----------
        stamp_s : float
            The packet's own stamp of its first sample, device seconds.
        n : int
            Samples in the packet.
        lost : int
            Samples missing since the previous packet.

        Raises
        ------
        ValueError
            If `stamp_s` is not finite or a count is negative.
        """
        if not math.isfinite(stamp_s) or n < 0 or lost < 0:
            raise ValueError(f"cannot place {n} samples after {lost} lost at {stamp_s}")
        first = self._chain(stamp_s, lost)
        self._next = first + n * self._period
        return first

    def _chain(self, stamp_s: float, lost: int) -> float:
        if self._next is not None:
            expected = self._next + lost * self._period
            error = stamp_s - expected
            if abs(error) <= self._tolerance:
                self._packets += 1
                return expected + error * max(TIMELINE_GAIN, 1 / self._packets)
            self._reanchors += 1
        self._packets = 1
        return stamp_s


class MonotonicStamps:
    """Keeps the stamps of one stream strictly increasing, even after a clock step."""

    def __init__(self) -> None:
        self._last = -math.inf
        self._corrections = 0

    @property
    def corrections(self) -> int:
        """How many stamps were moved."""
        return self._corrections

    def apply(self, stamps: Iterable[float]) -> list[float]:
        """Return the stamps; one that is not later than its predecessor is moved 1 us after it.

        Raises
        ------
        ValueError
            If a stamp is not finite; the stamps before it count as emitted.
        """
        emitted: list[float] = []
        for stamp in stamps:
            if not math.isfinite(stamp):
                raise ValueError(f"a timestamp must be finite, got {stamp}")
            if stamp <= self._last:
                self._corrections += 1
                self._last = max(
                    self._last + MONOTONIC_STEP_S, math.nextafter(self._last, math.inf)
                )
            else:
                self._last = stamp
            emitted.append(self._last)
        return emitted
