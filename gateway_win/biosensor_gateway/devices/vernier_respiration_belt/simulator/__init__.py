"""A virtual GDX-RB: packets, firmware, and the belt on the air."""

from biosensor_gateway.devices.vernier_respiration_belt.simulator.belt import SimulatedBelt

__all__ = ["SimulatedBelt"]
