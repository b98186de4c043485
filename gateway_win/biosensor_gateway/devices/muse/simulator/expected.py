"""The facts that an agent can know of a headband."""

from dataclasses import replace

from biosensor_gateway.simulation.expected import (
    NO_INTERVALS,
    ONE_RATE,
    USUALLY_IMPOSSIBLE,
    Expected,
    Gap,
    LossTolerance,
)
from biosensor_gateway.simulation.faults import FaultKind, Untidiness

CLASSIC = Expected(
    # It comes without a time.
    unstamped_s={"bat": 0.0},
    # Each connection begins to count again, and is placed by its arrival.
    loss_tolerance=LossTolerance(over_break=48, by_arrival=True),
    impossible={
        FaultKind.OFF_BODY: "it does not tell whether anybody wears it",
        FaultKind.REPEAT: NO_INTERVALS,
        Untidiness.RATE: ONE_RATE,
        Untidiness.APART: "packets leave in the order of their electrodes; one of which none "
        "leave is a loss",
    },
)
ATHENA = replace(
    CLASSIC,
    unstamped_s={},
    impossible={
        **CLASSIC.impossible,
        Untidiness.APART: USUALLY_IMPOSSIBLE[Untidiness.APART],
        FaultKind.DENY: "all that it measures comes by one characteristic",
    },
    # Each connection begins to count again, and is placed by the device's clock.
    loss_tolerance=LossTolerance(over_break=48),
    # Its clock begins again.
    gaps={FaultKind.RESTART: Gap.STOPPED},
)
