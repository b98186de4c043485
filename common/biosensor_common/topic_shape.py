"""Depth of a topic's queue, and the type of its chunks."""

from __future__ import annotations

from math import ceil

from biosensor_common.quantities import MessageType

# On a network that loses packets, or is away for some seconds, what is sent again must
# still be there; measured with 5 % of all packets lost and with a cut of 6 s.
DEPTH_S = 30.0
MIN_RATE_HZ, MAX_DEPTH = 10.0, 100_000

_WIDE = frozenset(
    {
        MessageType.FLOAT64_MULTI_ARRAY,
        MessageType.INT32_MULTI_ARRAY,
        MessageType.INT64_MULTI_ARRAY,
    }
)


def piece_messages(rate: float) -> int:
    """Return how many messages, of a topic of so many Hz, fill half of its queue."""
    return queue_depth(rate) // 2


def queue_depth(rate: float) -> int:
    """Return how many messages are kept, of a topic of so many Hz; 0 for an irregular one."""
    # The rate of another program's stream may be any number.
    return ceil(min(max(rate, MIN_RATE_HZ) * DEPTH_S, MAX_DEPTH))


def chunk_type(raw: MessageType) -> MessageType:
    """Message type of a stream's chunks; a wider raw type keeps its precision."""
    return raw if raw in _WIDE else MessageType.FLOAT32_MULTI_ARRAY
