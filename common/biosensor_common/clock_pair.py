"""One moment on two clocks: LSL's and the computer's.

Agent and node put such pairs into their streams of events, so that a recording can be
put on the time of day, and a recording and a bag of one session onto one axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple, cast

from biosensor_common.ros_clock import NS_PER_S, measure_offset_ns

KEY = "clock"
# Times of day of the years 1970 to 2262, as far as 64 bits go.
_MOST_NS = 1 << 63


class ClockPair(NamedTuple):
    """LSL time in s, and unix time in ns at the same moment."""

    lsl_s: float
    unix_ns: int

    def as_facts(self) -> dict[str, object]:
        """Return the element of an event, for JSON."""
        return {KEY: {"lsl_s": self.lsl_s, "unix_ns": self.unix_ns}}


def measure_clock_pair(system_ns: Callable[[], int], lsl_s: Callable[[], float]) -> ClockPair:
    """Read both clocks at one moment, to some microseconds."""
    offset_ns = measure_offset_ns(system_ns, lsl_s)
    now_s = round(lsl_s(), 6)
    return ClockPair(now_s, round(now_s * NS_PER_S) + offset_ns)


def read_clock_pair(event: object) -> ClockPair | None:
    """Return the pair in an event, as JSON gives it; None if it has none that makes sense."""
    if not isinstance(event, dict):
        return None
    told = cast("Mapping[str, object]", event).get(KEY)
    if not isinstance(told, dict):
        return None
    pair = cast("Mapping[str, object]", told)
    lsl_s, unix_ns = pair.get("lsl_s"), pair.get("unix_ns")
    if isinstance(lsl_s, bool) or not isinstance(lsl_s, int | float) or not math.isfinite(lsl_s):
        return None
    if isinstance(unix_ns, bool) or not isinstance(unix_ns, int) or not 0 <= unix_ns < _MOST_NS:
        return None
    return ClockPair(float(lsl_s), unix_ns)
