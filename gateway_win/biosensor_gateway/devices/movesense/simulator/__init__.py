"""Virtual Movesense sensors."""

from biosensor_gateway.devices.movesense.simulator.device import Firmware, SimulatedMovesense

__all__ = ["Firmware", "SimulatedMovesense"]
