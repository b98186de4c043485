"""The facts that an agent can know of the belt."""

from biosensor_gateway.simulation.expected import Contact, Expected, LossTolerance

EXPECTED = Expected(
    # A belt that nobody wears is loose.
    contact=Contact("quality", 1, off=-1.0),
    without_contact=("bpm",),
    by_agent=frozenset({"quality"}),
    # Each connection begins a new series, which is placed by its arrival.
    loss_tolerance=LossTolerance(over_break=2, by_arrival=True),
)
