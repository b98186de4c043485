"""The facts that an agent can know of an optical sensor."""

from dataclasses import replace

from biosensor_gateway.devices.polar_h10.simulator.expected import EXPECTED as STRAP
from biosensor_gateway.simulation.expected import Contact

EXPECTED = replace(
    STRAP,
    # Its channel has no role, for real ones are not to be believed; the virtual one is.
    contact=Contact("quality", 0),
    without_contact=("hr", "ppi"),
    # Of a batch of intervals, the last was over at some time in the second before it was sent.
    unstamped_s={"hr": 0.0, "ppi": 0.8},
)
