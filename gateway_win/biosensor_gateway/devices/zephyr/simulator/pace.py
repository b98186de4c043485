"""The pace of a virtual BioHarness's crystal: its milliseconds against true time."""

from __future__ import annotations


class Pace:
    """Device time since power-on; the past stays as it was when the pace changes.

    Parameters
    ----------
    speed
        Device seconds in a second, before drift.
    drift_ppm
        How much faster than that the crystal runs.
    """

    def __init__(self, speed: float, drift_ppm: float) -> None:
        self._speed = speed
        self._rate = speed * (1 + drift_ppm * 1e-6)
        self._true_s = 0.0
        self._device_ms = 0.0

    @property
    def rate(self) -> float:
        """Device seconds in a second now."""
        return self._rate

    def start(self, now: float) -> None:
        """Set device time 0 to ``now`` [s]."""
        self._true_s, self._device_ms = now, 0.0

    def device_ms(self, now: float) -> float:
        """Return the device time at ``now`` [s], not before the last `set_drift`."""
        return self._device_ms + 1000 * (now - self._true_s) * self._rate

    def true_s(self, device_ms: float) -> float:
        """Return when the device's time is ``device_ms`` [s]."""
        return self._true_s + (device_ms - self._device_ms) / 1000 / self._rate

    def set_drift(self, ppm: float, now: float) -> None:
        """Run faster by so much from ``now`` [s] on."""
        self._device_ms, self._true_s = self.device_ms(now), now
        self._rate = self._speed * (1 + ppm * 1e-6)
