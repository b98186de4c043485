"""Virtual Muse headbands."""

from biosensor_gateway.devices.muse.simulator.athena import SimulatedAthena
from biosensor_gateway.devices.muse.simulator.classic import SimulatedMuse

__all__ = ["SimulatedAthena", "SimulatedMuse"]
