"""Converts LSL time to ROS time and back, and a stream's stamps by its sender's clock."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pylsl
from numpy.typing import NDArray
from rclpy.node import Node

from biosensor_common.lsl.inlet import Stamps, local_clock
from biosensor_common.ros_clock import (
    MAX_TIME_S,
    NS_PER_S,
    OffsetTracker,
    measure_offset_ns,
)


class RosTime:
    """Maps stamps of this machine's LSL clock to ROS time.

    Under ``use_sim_time`` the clocks are not related: samples that came together then get the
    simulated time at which they were received.
    """

    def __init__(self, node: Node) -> None:
        self._clock = node.get_clock()
        self._tracker = OffsetTracker(_measure(), pylsl.local_clock())

    @property
    def is_simulated(self) -> bool:
        """Whether ROS time comes from ``/clock``."""
        return self._clock.ros_time_is_active

    @property
    def steps(self) -> int:
        """Number of steps of the system clock against the LSL clock."""
        return self._tracker.steps

    def refresh(self) -> int | None:
        """Measure the offset, once a second; return a step of the system clock in nanoseconds."""
        return self._tracker.update(_measure(), pylsl.local_clock())

    def are_times(self, lsl_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return for each stamp on this machine's LSL clock whether ROS can represent it."""
        if self.is_simulated:
            return np.isfinite(lsl_s)
        offset_s = self._tracker.to_ros_ns(0.0) / NS_PER_S
        with np.errstate(invalid="ignore"):
            return (lsl_s + offset_s >= 0) & (lsl_s + offset_s < MAX_TIME_S)

    def to_ns(self, lsl_s: float) -> int:
        """ROS time of a stamp on this machine's LSL clock, in nanoseconds."""
        if self.is_simulated:
            return self._clock.now().nanoseconds
        return self._tracker.to_ros_ns(lsl_s)

    def to_lsl_s(self, wall_ns: int) -> float:
        """LSL time of a time on this machine's system clock, in nanoseconds since 1970."""
        return self._tracker.to_lsl_s(wall_ns)


def _measure() -> int:
    return measure_offset_ns(time.time_ns, pylsl.local_clock)


NEAR_S = 86_400.0
"""A stamp within a day of a clock's present time is taken to be on that clock."""
_UNKNOWN = "the sender's clock has not been measured yet"


class Stamping:
    """Stamps of one stream as ROS time.

    Parameters
    ----------
    ros_time
        Converts this machine's LSL clock to ROS time.
    correction
        Returns the seconds between the sender's LSL clock and ours, None while unknown.
    """

    def __init__(self, ros_time: RosTime, correction: Callable[[], float | None]) -> None:
        self._ros_time = ros_time
        self._correction = correction
        # Whether the newest stamps are times since 1970, which scripts take from `time.time()`.
        self.is_unix = False

    @property
    def is_known(self) -> bool:
        """Whether the sender's clock has been measured."""
        return self._correction() is not None

    def local(self, stamp: float) -> float:
        """Return a stamp on this machine's LSL clock, in seconds.

        Raises
        ------
        ValueError
            If the sender's clock is not known yet.
        """
        correction = self._correction()
        if correction is None:
            raise ValueError(_UNKNOWN)
        is_near = abs(stamp - time.time()) < NEAR_S
        self.is_unix = is_near and abs(stamp + correction - local_clock()) >= NEAR_S
        # The sender's system clock cannot be measured, so the stamp is used unchanged.
        return self._ros_time.to_lsl_s(_to_ns(stamp)) if self.is_unix else stamp + correction

    def are_times(self, stamps: Stamps) -> NDArray[np.bool_]:
        """Return for each stamp whether :meth:`to_ns` can convert it.

        Raises
        ------
        ValueError
            If the sender's clock is not known yet.
        """
        correction = self._correction()
        if correction is None:
            raise ValueError(_UNKNOWN)
        is_time = self._ros_time.are_times(stamps + correction)
        return is_time | _are_unix(stamps, correction)

    def to_ns(self, stamps: Stamps) -> NDArray[np.int64]:
        """Return the ROS times of stamps, in nanoseconds.

        Raises
        ------
        ValueError
            If the sender's clock is not known yet, or a stamp is not finite.
        """
        times = [self._ros_time.to_ns(self.local(stamp)) for stamp in stamps.tolist()]
        return np.array(times, np.int64)

    def of_run(self, stamps: Stamps) -> NDArray[np.int64]:
        """Return the ROS times of samples that came together, in nanoseconds.

        Their spacing is that of the stamps. In simulated time the newest sample gets the present
        time and none a later one, for which there would be no transform.

        Raises
        ------
        ValueError
            As :meth:`to_ns`.
        """
        if self._ros_time.is_simulated:
            (now,) = self.to_ns(stamps[-1:])
            ages_s = np.clip(stamps[-1] - stamps, 0.0, now / NS_PER_S)
            return now - np.rint(ages_s * NS_PER_S).astype(np.int64)
        # One conversion for all, because the offset may change from one to the next.
        offsets = np.rint((stamps - stamps[0]) * NS_PER_S).astype(np.int64)
        # nothing is dropped: the others follow the first
        return self.to_ns(stamps[:1]) + offsets


def _are_unix(stamps: Stamps, correction: float) -> NDArray[np.bool_]:
    """Return for each stamp whether it is Unix time; some LSL clocks count from 1970, too."""
    with np.errstate(invalid="ignore"):
        is_unix = np.abs(stamps - time.time()) < NEAR_S
        return is_unix & (np.abs(stamps + correction - local_clock()) >= NEAR_S)


def _to_ns(stamp: float) -> int:
    whole = int(stamp)
    return whole * NS_PER_S + round((stamp - whole) * NS_PER_S)
