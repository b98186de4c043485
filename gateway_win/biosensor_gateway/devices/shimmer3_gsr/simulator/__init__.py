"""A virtual Shimmer3 GSR+: its commands, its analogue inputs and a serial link."""

from biosensor_gateway.devices.shimmer3_gsr.simulator.shimmer3 import SimulatedShimmer3

__all__ = ["SimulatedShimmer3"]
