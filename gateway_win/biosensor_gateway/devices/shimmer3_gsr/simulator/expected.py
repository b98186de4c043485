"""The facts that an agent can know of the Shimmer3."""

from biosensor_gateway.simulation.expected import Expected, Gap, LossTolerance
from biosensor_gateway.simulation.faults import FaultKind

EXPECTED = Expected(
    without_contact=("gsr",),
    # The heart rate is computed from the pulse wave.
    by_agent=frozenset({"hr", "quality"}),
    gaps={
        # Firmware stops streaming with the end of the link.
        FaultKind.DROP: Gap.STOPPED,
        FaultKind.REFUSE: Gap.STOPPED,
        FaultKind.LATE: Gap.STOPPED,
        FaultKind.RESTART: Gap.STOPPED,
        # Its radio link stayed: it stops only when the host closes the port, in silence.
        FaultKind.STALL: Gap.UNKNOWN,
        # It answers and sends nothing: whether it measures, nobody knows.
        FaultKind.FORGET: Gap.UNKNOWN,
        # It is started anew meanwhile, and nobody can read since when it measures.
        FaultKind.UNREADABLE: Gap.UNKNOWN,
    },
    # A quarter of a second may be on its way when the link breaks: in its radio, and in the
    # host's system, from which a busy host has not yet taken it.
    loss_tolerance=LossTolerance(over_break=32),
)
