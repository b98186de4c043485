"""Says how much of a stream an inlet buffers."""

from __future__ import annotations

# For as long may the node stand still. liblsl reserves 16 bytes a sample at once, on both sides:
# its own default, 360 s, is 1.5 MB for 256 Hz.
BUFFER_S = 120
# A stream of no rate may burst, and no time says how much that is: here liblsl's default stays.
BUFFER_HUNDREDS = 360
# What other programs announce may be anything, and liblsl would reserve memory for it.
BUFFER_SAMPLES = 4_000_000


def buffer_length(rate: float) -> int:
    """Return the seconds to buffer; hundreds of samples where the rate is 0, as liblsl has it."""
    if not rate:
        return BUFFER_HUNDREDS
    return BUFFER_S if rate * BUFFER_S <= BUFFER_SAMPLES else max(1, int(BUFFER_SAMPLES / rate))
