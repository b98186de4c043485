"""Signals that the virtual belt's sensors read."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.system.clock import Clock

RATE_WARM_UP_S = 25.0
"""The belt needs some breaths before it knows a rate."""
RATE_UPDATE_S = 10.0
_SLACK_N = -0.53
_CHANNELS = ((1, "force"), (2, "bpm"))


class Signals:
    """Force and respiration rate of a wearer who may take the belt off.

    Parameters
    ----------
    wearer
        Who wears it.
    warm_up_s
        It knows no respiration rate for so long after every start.
    clock
        The true time.
    """

    def __init__(self, wearer: Wearer, warm_up_s: float, clock: Clock) -> None:
        self._wearer = wearer
        self._warm_up_s = warm_up_s
        self._clock = clock
        self._worn = True
        self.begin()

    def begin(self) -> None:
        """Let the wearer's time begin now."""
        self._origin_s = self._worn_since_s = self._clock()

    def take_off(self) -> None:
        """Take the belt off: it hangs slack."""
        self._worn = False

    def put_on(self) -> None:
        """Put it on again."""
        self._worn, self._worn_since_s = True, self._clock()

    def rows(self, times: NDArray[np.float64], started_s: float) -> NDArray[np.float32]:
        """Return what is measured at some LSL times.

        Parameters
        ----------
        times : ndarray of float64, shape (n,)
        started_s
            LSL time at which the measurement was started.

        Returns
        -------
        ndarray of float32, shape (n, 6)
            Channels 0 to 5: force [N] in 1, rate [1/min] in 2, or NaN where none is known.
        """
        wearer_times = times - self._origin_s
        rows = np.zeros((len(times), 6), np.float32)
        if self._worn:
            rows[:, 1] = self._wearer.chest_force_n(wearer_times)
        else:
            rows[:, 1] = _SLACK_N + self._wearer.noise(wearer_times, 0.003, "slack")
        rows[:, 2] = self._rate(times[-1], started_s)
        return rows

    def _rate(self, time_s: float, started_s: float) -> float:
        known_since_s = max(started_s, self._worn_since_s) + self._warm_up_s
        if not self._worn or time_s < known_since_s:
            return math.nan
        updates = math.floor((time_s - known_since_s) / RATE_UPDATE_S)
        # The belt's own rate is a little off, differently each time.
        error = 0.3 * math.sin(1.7 * updates)
        return round(self._wearer.respiration_rate_bpm + error, 1)


def note(
    truth: Truth, times: NDArray[np.float64], rows: NDArray[np.float32], mask: int, *, sent: bool
) -> None:
    """Note in a truth what was measured of the channels in a mask, as sent or as lost."""
    for channel, data_name in _CHANNELS:
        if not mask & (1 << channel):
            continue
        if sent:
            values = rows[:, channel : channel + 1].astype(np.float64)
            truth.sent(data_name, times.tolist(), values.tolist())
        else:
            truth.unsent(data_name, len(times))
