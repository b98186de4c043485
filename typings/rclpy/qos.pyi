from enum import Enum

from rclpy.duration import Duration

class DurabilityPolicy(Enum):
    TRANSIENT_LOCAL = 1
    VOLATILE = 2

class ReliabilityPolicy(Enum):
    RELIABLE = 1
    BEST_EFFORT = 2

class QoSPolicyKind(Enum):
    HISTORY = 1
    DEPTH = 2
    RELIABILITY = 3
    DURABILITY = 4

class QoSProfile:
    def __init__(
        self,
        *,
        depth: int = ...,
        durability: DurabilityPolicy = ...,
        reliability: ReliabilityPolicy = ...,
        deadline: Duration = ...,
        liveliness_lease_duration: Duration = ...,
    ) -> None: ...
    @property
    def reliability(self) -> ReliabilityPolicy: ...
    @property
    def durability(self) -> DurabilityPolicy: ...
    @property
    def depth(self) -> int: ...
