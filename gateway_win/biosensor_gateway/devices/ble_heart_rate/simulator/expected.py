"""The facts that an agent can know of a heart-rate strap."""

from biosensor_gateway.simulation.expected import NO_RATE, SAYS_WHAT_IT_IS, Expected
from biosensor_gateway.simulation.faults import FaultKind, Untidiness

_NO_COMMANDS = "without a control point there is no command to refuse or to answer late"

EXPECTED = Expected(
    without_contact=("hr", "ibi"),
    by_agent=frozenset({"quality"}),
    # Of a beat, what is known of when it was in the second before its packet.
    unstamped_s={"hr": 0.0, "ibi": 0.1},
    impossible={
        FaultKind.REFUSE: _NO_COMMANDS,
        FaultKind.LATE: _NO_COMMANDS,
        Untidiness.RATE: NO_RATE,
        Untidiness.STRAY: SAYS_WHAT_IT_IS,
    },
)
