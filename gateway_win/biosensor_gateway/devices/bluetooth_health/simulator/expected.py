"""The facts that an agent can know of the device: as of a strap, but all without a stamp."""

from dataclasses import replace

from biosensor_gateway.devices.ble_heart_rate.simulator.expected import EXPECTED as ANY_STRAP

EXPECTED = replace(
    ANY_STRAP,
    without_contact=("spo2",),
    # Speed and cadence are reckoned from counted turns.
    by_agent=frozenset({"quality", "cycling"}),
    unstamped_s={"spo2": 0.0, "temp": 0.0, "running": 0.0, "power": 0.0},
)
