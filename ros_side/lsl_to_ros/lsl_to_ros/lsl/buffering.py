"""Says how much of a stream an inlet buffers."""

from __future__ import annotations

BUFFER_S = 360
# What other programs announce may be anything, and liblsl would reserve memory for it.
BUFFER_SAMPLES = 4_000_000


def buffer_length(rate: float) -> int:
    """Return the seconds to buffer; hundreds of samples where the rate is 0, as liblsl has it."""
    return BUFFER_S if rate * BUFFER_S <= BUFFER_SAMPLES else max(1, int(BUFFER_SAMPLES / rate))
