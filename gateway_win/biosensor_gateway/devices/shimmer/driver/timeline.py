"""Unwraps a counter of 24 bits into the device's time, and tells lost samples."""

from __future__ import annotations

from typing import NamedTuple

from biosensor_common.clocks import PacketTimeline
from biosensor_common.device_clock import LONGEST_DELAY_S
from biosensor_gateway.devices.shimmer.driver.commands import TICKS_PER_S
from biosensor_gateway.devices.shimmer.driver.protocol import TICK_MODULUS

SURVIVED_AGREE_S = 1.0
"""A counter that a new connection finds this near to where it should be was not restarted.
One that was restarted is that near by chance in one case of 256."""


class Placed(NamedTuple):
    """A packet's place in time.

    Attributes
    ----------
    time_s
        Device time.
    lost
        Samples lost right before it.
    restarted
        The counter was restarted: earlier times say nothing about later ones.
    """

    time_s: float
    lost: int
    restarted: bool = False


class TickTimeline:
    """Follows the counter of one device, over roll-overs, gaps and connections.

    The counter turns every 512 s. How often it turned in a gap is told by the times of
    arrival, so that a gap may have any length.
    """

    def __init__(self) -> None:
        self._ticks = PacketTimeline(TICK_MODULUS)
        self._arrival_s = 0.0
        self._divisor = 1
        self._is_new_connection = True

    def started(self, divisor: int) -> None:
        """Streaming was started at 32768 Hz / ``divisor``."""
        self._divisor = divisor
        self._is_new_connection = True

    def place(self, ticks: int, arrival_s: float) -> Placed | None:
        """Place the next packet; None for one that came before.

        Parameters
        ----------
        ticks
            Its timestamp, 0 to 2**24 - 1.
        arrival_s
            LSL clock at its arrival.
        """
        expected = (arrival_s - self._arrival_s) * TICKS_PER_S
        step = self._ticks.steps(ticks, expected, None)
        if step == 0 and not self._is_new_connection:
            return None
        lost, restarted = (0, False) if step is None else self._judged(step, expected)
        if restarted:
            # Time goes on, so that no sample seems older than those before it.
            least = max(self._divisor, round(expected))
            self._ticks.place(ticks, least, least)
        else:
            self._ticks.place(ticks, expected, None)
        self._arrival_s = arrival_s
        self._is_new_connection = False
        return Placed((self._ticks.newest or 0) / TICKS_PER_S, lost, restarted)

    def _judged(self, step: int, expected: float) -> tuple[int, bool]:
        """Return how many samples are missing, and whether the counter was restarted."""
        agree_s = SURVIVED_AGREE_S if self._is_new_connection else LONGEST_DELAY_S
        restarted = step <= 0 or abs(step - expected) > agree_s * TICKS_PER_S
        # A device that was started anew has measured nothing in between.
        is_counted = not restarted and not self._is_new_connection
        return max(0, round(step / self._divisor) - 1) if is_counted else 0, restarted
