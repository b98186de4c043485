"""A virtual E4 streaming server with wristbands: text lines over TCP."""

from biosensor_gateway.devices.empatica_e4.simulator.e4 import SimulatedE4
from biosensor_gateway.devices.empatica_e4.simulator.wire import NumberFormat
from biosensor_gateway.devices.empatica_e4.simulator.wristband import Timing

__all__ = ["NumberFormat", "SimulatedE4", "Timing"]
