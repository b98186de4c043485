"""The system clock against that of LSL."""

from __future__ import annotations

import time

import pylsl

NS_PER_S = 1_000_000_000
READINGS = 100


def system_minus_lsl_ns() -> int:
    """Return system time minus LSL time, from the narrowest of many bracketed readings."""
    readings: list[tuple[int, int]] = []
    for _ in range(READINGS):
        before, lsl_s, after = time.time_ns(), pylsl.local_clock(), time.time_ns()
        readings.append((after - before, (before + after) // 2 - round(lsl_s * NS_PER_S)))
    return min(readings)[1]
