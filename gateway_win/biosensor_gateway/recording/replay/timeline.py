"""Relates the time of a recording to the LSL time at which it is played."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Timeline:
    """``stamp = start + (time - begin) / speed``.

    Attributes
    ----------
    start_s
        LSL time, now, at which the recording's `begin_s` is played.
    begin_s
        LSL time on the clock of the computer that recorded.
    speed
        Seconds of the recording in one second, above 0.
    """

    start_s: float
    begin_s: float
    speed: float

    def stamps(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return when samples are played.

        Parameters
        ----------
        times : ndarray of float64, shape (n_samples,)
            When they were recorded.
        """
        return self.start_s + (times - self.begin_s) / self.speed

    def recorded(self, lsl_s: float) -> float:
        """Return the time of the recording that is played at an LSL time."""
        return self.begin_s + (lsl_s - self.start_s) * self.speed
