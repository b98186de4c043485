"""A virtual Polar strap that tells its heart rate to everybody."""

from biosensor_gateway.devices.polar_broadcast.simulator.device import SimulatedPolarBroadcast

__all__ = ["SimulatedPolarBroadcast"]
