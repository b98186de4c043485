"""A virtual E4 streaming server with wristbands: text lines over TCP."""

from biosensor_gateway.devices.empatica_e4.simulator.e4 import SimulatedE4
from biosensor_gateway.devices.empatica_e4.simulator.number_format import NumberFormat
from biosensor_gateway.devices.empatica_e4.simulator.radio_link import Timing

__all__ = ["NumberFormat", "SimulatedE4", "Timing"]
