"""The facts that an agent can know of a headband."""

from dataclasses import replace

from biosensor_gateway.simulation.expected import Expected, Gap, LossTolerance
from biosensor_gateway.simulation.faults import FaultKind

CLASSIC = Expected(
    # It comes without a time.
    unstamped_s={"bat": 0.0},
    # Each connection begins to count anew, and is placed by its arrival.
    loss_tolerance=LossTolerance(over_break=48, by_arrival=True),
    impossible={FaultKind.OFF_BODY: "it does not tell whether anybody wears it"},
)
ATHENA = replace(
    CLASSIC,
    unstamped_s={},
    # Each connection begins to count anew, and is placed by the device's clock.
    loss_tolerance=LossTolerance(over_break=48),
    # Its clock begins anew.
    gaps={FaultKind.RESTART: Gap.STOPPED},
)
