"""The facts that an agent can know of the wristband."""

from biosensor_gateway.simulation.expected import Expected, LossTolerance

EXPECTED = Expected(
    without_contact=("gsr",),
    by_agent=frozenset({"quality"}),
    # A loss is a time, told to 0.05 s, and some samples come six at a time.
    loss_tolerance=LossTolerance(always={"bvp": 4, "acc": 2, "gsr": 6, "st": 6}),
)
