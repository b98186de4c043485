"""Virtual Polar optical sensors."""

from biosensor_gateway.devices.polar_verity_sense.simulator.device import (
    SimulatedPolarVeritySense,
)

__all__ = ["SimulatedPolarVeritySense"]
