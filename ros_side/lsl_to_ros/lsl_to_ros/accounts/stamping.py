"""Maps stamps of the sender's LSL clock to ROS time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray

from lsl_to_ros.accounts.ros_time import RosTime
from lsl_to_ros.lsl.blocks import Stamps


class Stamping:
    """Stamps of one stream as ROS time.

    Parameters
    ----------
    ros_time
        This machine's LSL clock to ROS time.
    correction
        Returns the seconds between the sender's LSL clock and ours, None while unknown.
    """

    def __init__(self, ros_time: RosTime, correction: Callable[[], float | None]) -> None:
        self._ros_time = ros_time
        self._correction = correction

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
            raise ValueError("the sender's clock has not been measured yet")
        return stamp + correction

    def are_times(self, stamps: Stamps) -> NDArray[np.bool_]:
        """Say of each stamp whether :meth:`to_time` has a time for it.

        Raises
        ------
        ValueError
            If the sender's clock is not known yet.
        """
        return self._ros_time.are_times(stamps + self.local(0.0))

    def to_time(self, stamp: float) -> Time:
        """Return the ROS time of a stamp.

        Raises
        ------
        ValueError
            If the sender's clock is not known yet, or the stamp is not finite.
        """
        return self._ros_time.to_msg(self.local(stamp))
