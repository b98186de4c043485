"""Tells how much somebody moves, from acceleration."""

from __future__ import annotations

import numpy as np

from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.runs import Array, Event, Hops


class Activity:
    """Gives `activity_live`: the mean amplitude deviation of each epoch, stamped with its end.

    It is the mean distance of the vector's length from its own mean, in g, and needs no
    calibration: Vaha-Ypya 2015, see :mod:`.thresholds`.

    Parameters
    ----------
    rate
        Nominal, in Hz; values are three axes in g.
    """

    def __init__(self, rate: float) -> None:
        self._hops = Hops(max(2, round(at.ACTIVITY_EPOCH_S * rate)))

    def take(self, stamps: Array, values: Array) -> list[Event]:
        """Take samples of one run in; shapes (n,) and (n, 3)."""
        events: list[Event] = []
        for times, epoch in self._hops.take(stamps, values):
            length = np.sqrt(np.square(epoch).sum(axis=1))
            deviation = float(np.abs(length - length.mean()).mean())
            events.append(Event("activity_live", float(times[-1]), (deviation,)))
        return events
