"""The facts that an agent can know of the sensor: as of a strap, but that it takes commands."""

from dataclasses import replace

from biosensor_gateway.devices.ble_heart_rate.simulator.expected import EXPECTED as ANY_STRAP
from biosensor_gateway.simulation.expected import Gap, LossTolerance
from biosensor_gateway.simulation.faults import FaultKind

EXPECTED = replace(
    ANY_STRAP,
    impossible={},
    # It is switched off.
    gaps={FaultKind.RESTART: Gap.STOPPED},
    # Each connection begins a new series, which is placed by time.
    loss_tolerance=LossTolerance(over_break=2),
)
