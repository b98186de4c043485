"""Finds restarts of devices whose clock starts with their power."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

AGREE_S = 1.0
"""Tolerance between the device's and the host's length of a pause, if the device stayed on."""
DRIFT = 1e-3
"""Far more than the error of any oscillator."""


class RestartCheck:
    """Compares the first timestamp of each connection with the device's known clock.

    Data may have been stored since the start of a measurement and arrive late together, so
    lateness alone does not indicate a restart. If the clock continued, the first packet's time
    lies between the start and its arrival.
    """

    def __init__(self, sink: DeviceSink, agree_s: float = AGREE_S) -> None:
        self._sink = sink
        self._agree_s = agree_s
        self._started_s = -math.inf
        self._is_new = True

    def reconnected(self) -> None:
        """Expect the first packet of a connection, before its measurements are started."""
        self._is_new = True
        self._started_s = self._sink.clock()

    def counts_again(self, stamp_s: float, arrival_s: float) -> bool:
        """Whether the device's clock restarted; False for later packets of a connection."""
        is_new, self._is_new = self._is_new, False
        if not is_new:
            return False
        state = self._sink.clock_state
        if math.isnan(state.offset_s):
            return False
        measured_s = stamp_s + state.offset_s
        # Data stored in the device were lost with the previous connection, so nothing is older.
        limit_s = self._agree_s + DRIFT * max(0.0, arrival_s - state.newest_s)
        earliest_s = max(state.newest_s, min(self._started_s, arrival_s) - limit_s)
        return not earliest_s <= measured_s <= arrival_s + limit_s
