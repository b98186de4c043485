"""Converts LSL time to ROS time, and back."""

from __future__ import annotations

import time

import numpy as np
import pylsl
from numpy.typing import NDArray
from rclpy.node import Node

from biosensor_common.ros_clock import (
    MAX_TIME_S,
    NS_PER_S,
    OffsetTracker,
    measure_offset_ns,
)


class RosTime:
    """Maps stamps of this machine's LSL clock to ROS time.

    Under ``use_sim_time`` there is no relation to map by: the time of what came together is
    then the simulated time at which it was received.
    """

    def __init__(self, node: Node) -> None:
        self._clock = node.get_clock()
        self._tracker = OffsetTracker(_measure(), pylsl.local_clock())

    @property
    def is_simulated(self) -> bool:
        """Whether ROS goes by ``/clock``."""
        return self._clock.ros_time_is_active

    @property
    def steps(self) -> int:
        """How often the system clock jumped against the LSL clock."""
        return self._tracker.steps

    def refresh(self) -> int | None:
        """Measure again, once a second; return a jump of the system clock in nanoseconds."""
        return self._tracker.update(_measure(), pylsl.local_clock())

    def are_times(self, lsl_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Say of each stamp on this machine's LSL clock whether ROS has such a time."""
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
