"""Maps LSL time to ROS time, and back, by the offset between the two clocks of one machine.

On Linux the LSL clock is monotonic and the ROS clock is the system clock, which
NTP slews and people set. Simulated time cannot be mapped. The clock readers are passed in,
so that tests can use virtual clocks.

Agent and node put a `ClockPair` into their streams of events, so that a recording can be
put on the time of day, and a recording and a bag of one session onto one axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple, cast

from biosensor_common.plausible import finite

SLEW_S = 1.0
"""Samples that are late by up to this time are mapped with the offset of their own time."""
STEP_NS = 1_000_000
KNOTS_KEPT = 16

# The offset changes by at most 1 ms/s, so the second round is exact to a nanosecond.
_INVERSE_ROUNDS = 2

NS_PER_S = 1_000_000_000
MAX_TIME_S = 2.0**31 - 1e6
"""ROS stores seconds as int32; the margin is for slews and steps of the clock."""


def measure_offset_ns(
    system_ns: Callable[[], int], lsl_s: Callable[[], float], rounds: int = 10
) -> int:
    """Measure the offset: system clock minus LSL clock.

    Reads system, LSL, system and takes the round with the closest system readings:
    an interruption between the reads can only widen them.

    Parameters
    ----------
    system_ns : callable
        Reads the system (ROS) clock in nanoseconds.
    lsl_s : callable
        Reads the LSL clock in seconds.
    rounds : int
        Number of attempts, at least 1.

    Returns
    -------
    int
        Offset in nanoseconds, off by at most half the time between the two reads.

    Raises
    ------
    ValueError
        If `rounds` is less than 1.
    """
    if rounds < 1:
        raise ValueError(f"an offset needs at least one round, not {rounds}")
    brackets: list[tuple[int, int]] = []
    for _ in range(rounds):
        before, lsl, after = system_ns(), lsl_s(), system_ns()
        # The width is negative if the clock was set back in between, so its size counts.
        brackets.append((abs(after - before), (before + after) // 2 - _to_ns(lsl)))
    return min(brackets)[1]


class OffsetTracker:
    """Maps LSL times to ROS times with an offset that is measured repeatedly.

    The offset is piecewise linear over LSL time: it reaches each new measurement
    within one second, so its slope is at most 1 ms/s. Earlier times keep the offset
    that they had. A change of more than 1 ms is a step and applies to all times.

    One thread may update while others convert.

    Parameters
    ----------
    offset_ns : int
        First measurement, from `measure_offset_ns`.
    now_s : float
        LSL clock at that measurement, in seconds.
    """

    def __init__(self, offset_ns: int, now_s: float) -> None:
        # The tuple is replaced as a whole and never changed, so that reading it is thread-safe.
        self._knots: tuple[tuple[float, int], ...] = ((_finite(now_s), offset_ns),)
        self._steps = 0

    @property
    def steps(self) -> int:
        """Number of steps of the offset."""
        return self._steps

    def update(self, offset_ns: int, now_s: float) -> int | None:
        """Add a measurement.

        Parameters
        ----------
        offset_ns : int
            System clock minus LSL clock, in nanoseconds.
        now_s : float
            LSL clock at the measurement, in seconds.

        Returns
        -------
        int or None
            After a step of the system clock, which applies at once: the new offset minus the
            previous one, in nanoseconds.

        Raises
        ------
        ValueError
            If `now_s` is not finite.
        """
        present = self._offset_at(_finite(now_s))
        change = offset_ns - present
        if abs(change) > STEP_NS:
            self._knots = ((now_s, offset_ns),)
            self._steps += 1
            return change
        past = tuple(knot for knot in self._knots if knot[0] < now_s)
        ramp = ((now_s, present), (now_s + SLEW_S, offset_ns))
        self._knots = past[-KNOTS_KEPT:] + ramp
        return None

    def to_ros_ns(self, lsl_s: float) -> int:
        """Return the ROS time of an LSL time, in nanoseconds.

        The sum uses integers, because nanoseconds since 1970 do not fit a float.

        Raises
        ------
        ValueError
            If `lsl_s` is not finite.
        """
        return _to_ns(lsl_s) + self._offset_at(lsl_s)

    def to_lsl_s(self, ros_ns: int) -> float:
        """Return the LSL time of a ROS time: the inverse of :meth:`to_ros_ns`.

        The offset changes by at most 1 ms/s, so each round reduces the error to a thousandth.
        """
        lsl_s = (ros_ns - self._knots[-1][1]) / NS_PER_S
        for _ in range(_INVERSE_ROUNDS):
            lsl_s = (ros_ns - self._offset_at(lsl_s)) / NS_PER_S
        return lsl_s

    def _offset_at(self, lsl_s: float) -> int:
        knots = self._knots
        place = len(knots)
        # Searched from the end, because nearly all times are of the last second.
        while place and lsl_s < knots[place - 1][0]:
            place -= 1
        if place == 0:
            return knots[0][1]
        if place == len(knots):
            return knots[-1][1]
        (start, offset), (end, target) = knots[place - 1], knots[place]
        return offset + round((target - offset) * (lsl_s - start) / (end - start))


def _to_ns(seconds: float) -> int:
    """Convert seconds to nanoseconds exactly; multiplying by 1e9 would round twice."""
    whole = math.floor(_finite(seconds))
    return whole * NS_PER_S + round((seconds - whole) * NS_PER_S)


def _finite(reading: float) -> float:
    if not math.isfinite(reading):
        raise ValueError(f"a clock reading must be finite, got {reading}")
    return reading


KEY = "clock"
# Unix times of the years 1970 to 2262, the range of 64-bit nanoseconds.
_MOST_NS = 1 << 63


class ClockPair(NamedTuple):
    """LSL time in s, and Unix time in ns at the same moment."""

    lsl_s: float
    unix_ns: int

    def as_facts(self) -> dict[str, object]:
        """Return the pair as JSON content of an event."""
        return {KEY: {"lsl_s": self.lsl_s, "unix_ns": self.unix_ns}}


def measure_clock_pair(system_ns: Callable[[], int], lsl_s: Callable[[], float]) -> ClockPair:
    """Read both clocks at the same moment, to a few microseconds."""
    offset_ns = measure_offset_ns(system_ns, lsl_s)
    now_s = round(lsl_s(), 6)
    return ClockPair(now_s, round(now_s * NS_PER_S) + offset_ns)


def read_clock_pair(event: object) -> ClockPair | None:
    """Return the pair of an event parsed from JSON; None if it has no valid one."""
    if not isinstance(event, dict):
        return None
    told = cast("Mapping[str, object]", event).get(KEY)
    if not isinstance(told, dict):
        return None
    pair = cast("Mapping[str, object]", told)
    lsl_s, unix_ns = finite(pair.get("lsl_s")), pair.get("unix_ns")
    if lsl_s is None or abs(lsl_s) > MAX_TIME_S:
        return None
    if isinstance(unix_ns, bool) or not isinstance(unix_ns, int) or not 0 <= unix_ns < _MOST_NS:
        return None
    return ClockPair(lsl_s, unix_ns)
