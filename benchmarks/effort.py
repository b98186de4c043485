"""How long is measured."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Effort:
    """Durations and repetitions of one run.

    Attributes
    ----------
    rounds
        Of each measurement that is compared with a floor.
    one_s, sixteen_s, chunks_s, idle_s, bursts_s, agent_s, features_s
        What one round takes without its preparation.
    settle_s
        Time for what starts up to come to rest.
    node_restarts
        Of the node.
    restarts
        Of the outlet, in each way.
    rotations
        In each of them all streams have come and gone once, in 16 s.
    staying_s
        How long streams that stay are watched.
    page_s
        How long a page that stays open is watched.
    published
        Chunks that are published.
    taped_s, passes
        Of each decoder.
    clock_seeds
        Simulated courses of each way, packet rate and drift.
    recording_s
        Length of the recording that is exported.
    """

    rounds: int
    one_s: float
    sixteen_s: float
    chunks_s: float
    idle_s: float
    settle_s: float
    bursts_s: float
    node_restarts: int
    restarts: int
    rotations: int
    staying_s: float
    page_s: float
    published: int
    agent_s: float
    features_s: float
    taped_s: float
    passes: int
    clock_seeds: int
    recording_s: float


FULL = Effort(
    rounds=3,
    one_s=10.0,
    sixteen_s=10.0,
    chunks_s=15.0,
    idle_s=10.0,
    settle_s=2.0,
    bursts_s=60.0,
    # One slow start in thirty was what fewer did not show.
    node_restarts=30,
    restarts=3,
    # In ten minutes.
    rotations=38,
    staying_s=600.0,
    page_s=1800.0,
    published=200,
    agent_s=30.0,
    features_s=60.0,
    taped_s=5.0,
    passes=15,
    clock_seeds=10,
    recording_s=7200.0,
)
QUICK = Effort(
    rounds=1,
    one_s=2.0,
    sixteen_s=2.0,
    chunks_s=3.0,
    idle_s=2.0,
    settle_s=0.5,
    bursts_s=5.0,
    node_restarts=1,
    restarts=1,
    # Fewer make no slope.
    rotations=10,
    staying_s=160.0,
    # Fewer groups make no slope.
    page_s=300.0,
    published=50,
    agent_s=4.0,
    features_s=15.0,
    taped_s=1.0,
    passes=5,
    clock_seeds=3,
    recording_s=300.0,
)
