"""Knows how late an event loop is with what it is to do."""

from __future__ import annotations

import asyncio

from biosensor_gateway.system.clock import LSL_CLOCK, Clock

TICK_S = 0.05
KEPT_S = 1.0
"""How long the longest delay counts, at least; at most twice as long."""
TURNS = 3
"""Of the loop, which a packet may wait for: a virtual device's, to be read, to be noted."""
MOST_S = 0.5
"""What is held up for longer is a stall, and not a busy computer."""


class LoopLag:
    """How late the loop has been with what was due.

    On a busy computer what is due has to wait, and so has what comes meanwhile. Must be made in
    the loop, and run from then on.

    Parameters
    ----------
    clock
        Whose timers the loop goes by.
    """

    def __init__(self, clock: Clock = LSL_CLOCK) -> None:
        self._clock = clock
        self._due = clock()
        self._longest_s = self._longest_before_s = 0.0
        self._since = self._due

    def seconds(self) -> float:
        """Return the longest delay of the last second or two, with what is overdue now."""
        overdue_s = self._clock() - self._due
        return min(MOST_S, max(overdue_s, self._longest_s, self._longest_before_s))

    def packet_delay_s(self) -> float:
        """Return for how long a packet that comes now may have waited for the loop."""
        return TURNS * self.seconds()

    async def run(self) -> None:
        """Measure until cancelled."""
        while True:
            self._due = self._clock() + TICK_S
            await asyncio.sleep(TICK_S)
            self._note(self._clock())

    def _note(self, now: float) -> None:
        if now - self._since >= KEPT_S:
            self._longest_before_s, self._longest_s, self._since = self._longest_s, 0.0, now
        self._longest_s = max(self._longest_s, now - self._due)
