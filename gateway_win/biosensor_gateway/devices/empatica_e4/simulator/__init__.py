"""A virtual E4 streaming server with wristbands: text lines over TCP."""

from biosensor_gateway.devices.empatica_e4.simulator.number_format import NumberFormat
from biosensor_gateway.devices.empatica_e4.simulator.twin import SimulatedE4

__all__ = ["NumberFormat", "SimulatedE4"]
