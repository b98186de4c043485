"""Depth of a topic's queue, and the type of its chunks."""

from __future__ import annotations

from math import ceil

from biosensor_common.quantities import MessageType

# When a network loses packets or fails for some seconds, messages to be sent again must
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
    """Return how many messages of a topic with this rate in Hz fill half of its queue."""
    return queue_depth(rate) // 2


def queue_depth(rate: float) -> int:
    """Return the queue depth of a topic with this rate in Hz, 0 for an irregular one."""
    # A foreign stream may announce any rate.
    return ceil(min(max(rate, MIN_RATE_HZ) * DEPTH_S, MAX_DEPTH))


def chunk_type(raw: MessageType) -> MessageType:
    """Return the message type of a stream's chunks, which keeps the precision of its raw type."""
    return raw if raw in _WIDE else MessageType.FLOAT32_MULTI_ARRAY
