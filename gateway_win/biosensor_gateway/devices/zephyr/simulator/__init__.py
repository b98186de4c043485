"""A virtual BioHarness 3: a source of packets, a command session and a serial link."""

from biosensor_gateway.devices.zephyr.simulator.recorded_bioharness import RecordedZephyr
from biosensor_gateway.devices.zephyr.simulator.zephyr import SimulatedZephyr

__all__ = ["RecordedZephyr", "SimulatedZephyr"]
