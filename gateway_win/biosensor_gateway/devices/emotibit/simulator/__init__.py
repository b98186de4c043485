"""A virtual EmotiBit."""

from biosensor_gateway.devices.emotibit.simulator.emotibit import SimulatedEmotiBit

__all__ = ["SimulatedEmotiBit"]
