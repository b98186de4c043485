"""Unwraps counters, spreads packets evenly over time, keeps stamps from running back.

The other clock arithmetic: `biosensor_common.device_clock` maps a device's clock to
the LSL clock, `biosensor_common.ros_clock` the LSL clock to ROS time. None of it
reads a clock.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

TIMELINE_GAIN = 1 / 16
TIMELINE_TOLERANCE_S = 0.020
"""Recorded stamps strayed 8 ms from their chain; a miscounted packet makes 250 ms or more."""

MONOTONIC_STEP_S = 1e-6
"""Survives a float of any LSL clock and the rounding to ROS nanoseconds."""


def lost_packets(previous: int, current: int, modulus: int) -> int:
    """Count the packets missing between two sequence numbers.

    Parameters
    ----------
    previous, current : int
        Sequence numbers of two packets received one after the other.
    modulus : int
        Number of different sequence numbers: 256 for one byte.

    Returns
    -------
    int
        0 to ``modulus - 1``. Whole cycles are invisible, and a repeated number
        counts as ``modulus - 1``: drop duplicates first.

    Raises
    ------
    ValueError
        If a sequence number is outside ``0 .. modulus - 1``.
    """
    for number in (previous, current):
        if not 0 <= number < modulus:
            raise ValueError(f"sequence number {number} is outside 0..{modulus - 1}")
    return (current - previous - 1) % modulus


class CounterUnwrapper:
    """Turns a counter of a few bits into one that never wraps.

    A value up to 1/16 of the range behind the newest is a late packet: it gets its
    own earlier count, and the newest stays. Anything else is ahead, so gaps of up
    to 15/16 of the range are bridged. Longer gaps cannot be seen in the counter.

    Parameters
    ----------
    bits : int
        Width of the counter, at least 1.

    Raises
    ------
    ValueError
        If `bits` is less than 1.
    """

    def __init__(self, bits: int) -> None:
        if bits < 1:
            raise ValueError(f"a counter has at least one bit, not {bits}")
        self._modulus = 1 << bits
        self._newest: int | None = None

    def unwrap(self, value: int) -> int:
        """Return the count without wraps; the first value is returned as it is.

        Raises
        ------
        ValueError
            If `value` does not fit the counter's bits.
        """
        if not 0 <= value < self._modulus:
            raise ValueError(f"counter value {value} is outside 0..{self._modulus - 1}")
        if self._newest is None:
            self._newest = value
            return value
        behind = (self._newest - value) % self._modulus
        if behind <= self._modulus // 16:
            return self._newest - behind
        self._newest += self._modulus - behind
        return self._newest

    def reset(self) -> None:
        """Forget the past, as after a restart of the counter."""
        self._newest = None


class SampleTimeline:
    """Device times of regular samples whose packets carry jittering stamps.

    Samples are chained by counting; the stamps only pull the chain slowly, so that
    a sampling clock which drifts against the stamping clock is followed. Where
    chain and stamp disagree by more than 20 ms (half a period, if that is more), a
    loss was miscounted or the clock was set, and the chain starts anew at the stamp.

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
            raise ValueError(f"a sampling period is positive, not {period_s}")
        self._period = period_s
        self._tolerance = max(TIMELINE_TOLERANCE_S, period_s / 2)
        self._next: float | None = None
        self._packets = 0
        self._reanchors = 0

    @property
    def reanchors(self) -> int:
        """How often the chain was given up for a stamp."""
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
            Samples missing since the packet before.

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
    """Keeps the stamps of one stream strictly increasing, whatever the clocks did."""

    def __init__(self) -> None:
        self._last = -math.inf
        self._corrections = 0

    @property
    def corrections(self) -> int:
        """How many stamps were moved."""
        return self._corrections

    def apply(self, stamps: Iterable[float]) -> list[float]:
        """Return the stamps; each that does not follow its predecessor is moved 1 us behind it.

        Raises
        ------
        ValueError
            If a stamp is not finite; the stamps before it count as emitted.
        """
        emitted: list[float] = []
        for stamp in stamps:
            if not math.isfinite(stamp):
                raise ValueError(f"a stamp must be finite, got {stamp}")
            if stamp <= self._last:
                self._corrections += 1
                self._last = max(
                    self._last + MONOTONIC_STEP_S, math.nextafter(self._last, math.inf)
                )
            else:
                self._last = stamp
            emitted.append(self._last)
        return emitted
