"""The facts that an agent can know of the BioHarness."""

from biosensor_gateway.simulation.expected import Expected, LossTolerance

EXPECTED = Expected(
    without_contact=("hr", "br"),
    by_agent=frozenset({"quality"}),
    # Packets are numbered and stamped; after a restart it measures between two of them.
    loss_tolerance=LossTolerance(over_restart={"ecg": 63, "breathing": 18, "acc": 20}),
)
