"""Virtual Movesense sensors."""

from biosensor_gateway.devices.movesense.simulator.device import SimulatedMovesense

__all__ = ["SimulatedMovesense"]
