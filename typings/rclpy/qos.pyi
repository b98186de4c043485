from enum import Enum

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
    ) -> None: ...
    @property
    def reliability(self) -> ReliabilityPolicy: ...
    @property
    def durability(self) -> DurabilityPolicy: ...
    @property
    def depth(self) -> int: ...

class QoSCompatibility(Enum):
    OK = 0
    WARNING = 1
    ERROR = 2

def qos_check_compatible(
    publisher_qos: QoSProfile, subscription_qos: QoSProfile
) -> tuple[QoSCompatibility, str]: ...
