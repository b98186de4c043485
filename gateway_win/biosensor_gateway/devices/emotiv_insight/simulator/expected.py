"""The facts that an agent can know of the headset."""

from biosensor_gateway.simulation.expected import Contact, Expected, Gap
from biosensor_gateway.simulation.faults import FaultKind

EXPECTED = Expected(
    # The contact of all electrodes together, in percent.
    contact=Contact("dev", 7),
    without_contact=("met",),
    # Cortex lets go of the headset, which then measures nothing. Its numbers and times tell
    # exactly what is lost.
    gaps={FaultKind.RESTART: Gap.STOPPED},
)
