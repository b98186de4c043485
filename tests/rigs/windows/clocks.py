"""The clocks of one computer: what its programs call now."""

from __future__ import annotations

import time
from typing import NamedTuple

import pylsl

_READINGS = 100


class Clocks(NamedTuple):
    """How far a computer's clocks are apart, in seconds."""

    unix_minus_lsl: float  # Unix time minus the LSL clock of Linux programs.
    # The LSL clock of Windows programs minus that of Linux ones: Wine's performance counter is not
    # slewed with the time of day as the monotonic clock is.
    windows_minus_lsl: float


def read_clocks() -> Clocks:
    """Read all clocks of this computer; of several times that which took least."""
    reads: list[tuple[float, Clocks]] = []
    for _ in range(_READINGS):
        before = time.clock_gettime(time.CLOCK_MONOTONIC_RAW)
        lsl, unix = pylsl.local_clock(), time.time()
        after = time.clock_gettime(time.CLOCK_MONOTONIC_RAW)
        reads.append((after - before, Clocks(unix - lsl, (before + after) / 2 - lsl)))
    return min(reads)[1]
