"""Virtual heart-rate straps."""

from biosensor_gateway.devices.ble_heart_rate.simulator.device import SimulatedHeartRateStrap

__all__ = ["SimulatedHeartRateStrap"]
