"""A virtual Polar H10 to which a test does more than there are faults."""

from __future__ import annotations

from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.polar_h10.simulator.pmd import Measurement


class SteeredPolarH10(SimulatedPolarH10):
    """It does by itself what a test tells it."""

    def stop_measurements(self, *measurements: Measurement) -> None:
        """Have the device stop measurements by itself and tell the host."""
        if self._pmd is not None:
            self.world.await_(self._pmd.stop(measurements))

    def forget_heart_rate(self) -> None:
        """Have the device take it that nobody has subscribed to its heart rate."""
        self.world.call(self._strap.forget)
