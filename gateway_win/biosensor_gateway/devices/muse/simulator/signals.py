"""Measures a headband's wearer."""

from __future__ import annotations

import numpy as np

from biosensor_gateway.simulation.wearer import Floats, Wearer

_LIGHT = {
    # Level, share of the pulse and noise [counts].
    "ambient": (4000.0, 0.0, 12.0),
    "infrared": (150_000.0, 2500.0, 20.0),
    "red": (90_000.0, 900.0, 20.0),
}


class Signals:
    """The wearer's signals at true times on the LSL clock.

    Parameters
    ----------
    wearer

    Attributes
    ----------
    origin_s
        LSL time at which the wearer's time is 0.
    """

    def __init__(self, wearer: Wearer) -> None:
        self.origin_s = 0.0
        self._wearer = wearer

    def eeg_uv(self, times: Floats, electrode: str) -> Floats:
        """Potential of an electrode [uV]."""
        return self._wearer.eeg_uv(times - self.origin_s, electrode)

    def light(self, times: Floats, colour: str) -> Floats:
        """Light that comes back from the skin [counts]."""
        level, share, noise = _LIGHT[colour]
        t = times - self.origin_s
        return level + share * self._wearer.pulse(t) + self._wearer.noise(t, noise, colour)

    def acceleration_g(self, times: Floats) -> Floats:
        """Acceleration [g], shape (n, 3)."""
        return self._wearer.acceleration_g(times - self.origin_s)

    def rotation_dps(self, times: Floats) -> Floats:
        """Rate of rotation [deg/s], shape (n, 3)."""
        t = times - self.origin_s
        return np.stack([self._wearer.noise(t, 0.5, f"gyro{axis}") for axis in "xyz"], axis=1)
