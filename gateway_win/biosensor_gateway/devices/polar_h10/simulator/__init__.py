"""Virtual Polar H10, and others of its family."""

from biosensor_gateway.devices.polar_h10.simulator.device import SimulatedPolarH10

__all__ = ["SimulatedPolarH10"]
