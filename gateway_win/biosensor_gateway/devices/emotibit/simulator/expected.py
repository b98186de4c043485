"""The facts that an agent can know of the EmotiBit."""

from biosensor_gateway.simulation.expected import Expected, Gap, LossTolerance
from biosensor_gateway.simulation.faults import FaultKind

_UNAWARE = "nothing in it knows whether it is worn"

EXPECTED = Expected(
    by_agent=frozenset({"st"}),
    gaps={
        # Its clock begins anew, so nobody knows how long it was off.
        FaultKind.RESTART: Gap.UNKNOWN,
    },
    # Across a gap, samples are told by times at which they were read, up to a period late.
    loss_tolerance=LossTolerance(over_break=2),
    impossible={FaultKind.OFF_BODY: _UNAWARE},
)
