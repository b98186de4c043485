"""The oscillator of a virtual device: converts between true and device time."""

from __future__ import annotations

import asyncio

from biosensor_gateway.system.clock import Clock


class Oscillator:
    """Device time since power-on, running fast by some ppm.

    Parameters
    ----------
    clock
        The true time, on the LSL clock.
    drift_ppm
        Positive for fast: more device seconds than true ones.
    start_s
        True time of power-on on the LSL clock; now by default.
    """

    def __init__(self, clock: Clock, drift_ppm: float = 0.0, start_s: float | None = None) -> None:
        self.clock = clock
        self._true_s = clock() if start_s is None else start_s
        self._device_s = 0.0
        self._rate = 1 + drift_ppm * 1e-6

    @property
    def drift_ppm(self) -> float:
        """Current drift of the oscillator."""
        return (self._rate - 1) * 1e6

    def now(self) -> float:
        """Return device seconds since power-on."""
        return self.at(self.clock())

    def at(self, true_s: float) -> float:
        """Return device seconds at an LSL time, not before the last `set_drift`."""
        return self._device_s + (true_s - self._true_s) * self._rate

    def true_time(self, device_s: float) -> float:
        """Return the LSL time at which the device's clock shows ``device_s``."""
        return self._true_s + (device_s - self._device_s) / self._rate

    async def reach(self, device_s: float) -> float:
        """Wait until the device's clock shows ``device_s``; return the true time."""
        left = self.true_time(device_s) - self.clock()
        if left <= 0:
            return self.true_time(device_s)
        await asyncio.sleep(left)
        # The drift may have changed during the wait.
        return await self.reach(device_s)

    def set_drift(self, ppm: float) -> None:
        """Change the drift from now on."""
        now = self.clock()
        self._device_s, self._true_s = self.at(now), now
        self._rate = 1 + ppm * 1e-6
