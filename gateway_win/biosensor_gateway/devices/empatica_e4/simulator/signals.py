"""Computes the readings of a wristband's sensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from biosensor_gateway.devices.empatica_e4.simulator.number_format import as_sent
from biosensor_gateway.devices.empatica_e4.simulator.wire import (
    ACC,
    BVP,
    COUNTS_PER_G,
    GSR,
    TEMPERATURE,
    Stream,
)
from biosensor_gateway.simulation.wearer import PULSE_TRANSIT_S, Floats, Wearer

Rows = list[tuple[float, ...]]

_BVP_SCALE = 120.0
_AMBIENT_C = 24.5
_OPEN = 0.0
"""How the wire says that the electrodes touch no skin."""


class Signals:
    """The sensors of one wristband; every time is that of the wearer [s].

    Attributes
    ----------
    battery
        Charge, 0 to 1.
    """

    def __init__(self, wearer: Wearer) -> None:
        self.is_worn = True
        self.battery = 0.82
        self._wearer = wearer

    def read(self, stream: Stream, t: Floats) -> Rows:
        """Return what a regular stream reads at some times, as the wire can say it."""
        if stream is ACC:
            counts = np.rint(self._wearer.acceleration_g(t) * COUNTS_PER_G)
            return [tuple(row) for row in np.clip(counts, -128, 127).tolist()]
        return [(as_sent(value),) for value in self._read_one(stream, t).tolist()]

    def beats_between(self, begin_s: float, end_s: float) -> Sequence[float]:
        """Return when pulse waves reach the wrist, if there is one."""
        if not self.is_worn:
            return []
        peaks = self._wearer.beats_between(begin_s - PULSE_TRANSIT_S, end_s - PULSE_TRANSIT_S)
        times: list[float] = (peaks + PULSE_TRANSIT_S).tolist()
        return times

    def _read_one(self, stream: Stream, t: Floats) -> Floats:
        if stream is BVP:
            pulse = self._wearer.pulse(t) if self.is_worn else self._wearer.noise(t, 0.02, "light")
            return _BVP_SCALE * pulse
        if stream is GSR:
            return self._wearer.skin_conductance_us(t) if self.is_worn else np.full(t.shape, _OPEN)
        assert stream is TEMPERATURE
        # The sensor reads in steps of 0.02 degrees.
        celsius = self._wearer.skin_temperature_c(t) if self.is_worn else _ambient(t)
        return np.rint(celsius * 50) / 50


def _ambient(t: Floats) -> Floats:
    return np.full(t.shape, _AMBIENT_C)
