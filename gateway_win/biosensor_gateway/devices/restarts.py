"""Tells by the first stamp of a connection whether the device was switched off in between."""

from __future__ import annotations

import math

from biosensor_gateway.devices.sink import Sink

AGREE_S = 1.0
"""How exactly a device that stayed on agrees with the host on the length of a pause."""
DRIFT = 1e-3
"""Far more than any oscillator runs wrong."""


class RestartCheck:
    """Holds the first stamp of each connection against what is known of the device's clock.

    What was measured since the start of a measurement may have waited, and come late with others:
    lateness alone is no sign of a restart. A clock that went on puts the first packet between the
    start and its arrival.

    Parameters
    ----------
    sink
        Knows the device's clock.
    agree_s
        By so much the stamp may lie outside.
    """

    def __init__(self, sink: Sink, agree_s: float = AGREE_S) -> None:
        self._sink = sink
        self._agree_s = agree_s
        self._started_s = -math.inf
        self._is_new = True

    def reconnected(self) -> None:
        """Expect the first packet of a connection; none of its measurements has begun."""
        self._is_new = True
        self._started_s = self._sink.clock()

    def counts_again(self, stamp_s: float, arrival_s: float) -> bool:
        """Whether the device's clock did not go on; of later packets of a connection False."""
        is_new, self._is_new = self._is_new, False
        if not is_new:
            return False
        state = self._sink.clock_state
        if math.isnan(state.offset_s):
            return False
        measured_s = stamp_s + state.offset_s
        # What waited in the device was lost with the connection before, so nothing is older.
        limit_s = self._agree_s + DRIFT * max(0.0, arrival_s - state.newest_s)
        earliest_s = max(state.newest_s, min(self._started_s, arrival_s) - limit_s)
        return not earliest_s <= measured_s <= arrival_s + limit_s
