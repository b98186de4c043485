"""Virtual devices with standard Bluetooth services."""

from biosensor_gateway.devices.bluetooth_health.simulator.device import SimulatedHealthDevice

__all__ = ["SimulatedHealthDevice"]
