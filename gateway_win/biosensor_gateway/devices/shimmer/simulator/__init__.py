"""Virtual Shimmer3s and a Shimmer3R, written from documents on the firmware alone."""

from biosensor_gateway.devices.shimmer.simulator.units import (
    SimulatedEmgUnit,
    SimulatedExgUnit,
    SimulatedImuUnit,
    SimulatedShimmer3R,
)

__all__ = ["SimulatedEmgUnit", "SimulatedExgUnit", "SimulatedImuUnit", "SimulatedShimmer3R"]
