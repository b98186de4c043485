"""Determines whether a publisher's clock agrees with this computer's clock."""

from __future__ import annotations

import math
from enum import StrEnum, unique
from typing import NamedTuple

from biosensor_common.lower_envelope import LateRun, LowerEnvelope, Patience
from biosensor_common.ros_clock import NS_PER_S

AHEAD_S = 0.002
"""By how much a message may seem to arrive before it was sent: NTP's error in a lab network."""
WAY_S = 0.02
"""The fastest messages in a lab network take no longer; a larger delay may be the clock's error."""
BEHIND_S = 1.0
"""No network takes so long; a larger delay is the clock's error."""
PATIENCE_S = 2.0
"""For this time, late messages may still be explained by a backlog."""
SET_BACK = Patience(10.0, 10, spread=0.5)
"""If messages of a correct clock stay late, all by the same time, the clock was set."""
_PERIOD_S = 1.0


@unique
class ClockState(StrEnum):
    """State of a publisher's clock."""

    UNKNOWN = "unknown"
    """No message yet, or only late ones for a short time."""
    SYNCHRONISED = "synchronised"
    """To within `WAY_S`, or by measurement."""
    BEHIND = "behind"
    """By up to the edge, of which an unknown part is transmission delay."""
    WRONG = "wrong"


class Offset(NamedTuple):
    """Bounds of a publisher's clock minus this computer's clock, in seconds."""

    least_s: float
    most_s: float


class PublisherClock:
    """Tracks the lower edge of arrival minus stamp: the smallest delay plus the clock offset.

    Delays are never negative, so the edge of a correct clock is just above 0. If it is higher, only
    a measurement can separate offset and delay. A clock that was wrong once stays untrusted.

    Attributes
    ----------
    offset
        Measured offset; None without a measurement.
    """

    def __init__(self) -> None:
        self.state = ClockState.UNKNOWN
        self.offset: Offset | None = None
        self._first_delay_ns = self._first_arrival_ns = 0
        self._envelope: LowerEnvelope | None = None
        self._lowest = (0.0, math.inf)
        self._newest_s = self._period_begin_s = 0.0
        self._late = LateRun()

    @property
    def is_in_doubt(self) -> bool:
        """Whether messages were received, but their delay may still be the network's."""
        return self._envelope is not None and self.state is ClockState.UNKNOWN

    @property
    def edge_s(self) -> float:
        """Lower edge of arrival minus stamp, in seconds; NaN before the first message."""
        if self._envelope is None:
            return math.nan
        return self._first_delay_ns / NS_PER_S + min(
            self._envelope.at(self._newest_s), self._lowest[1]
        )

    @property
    def bound_s(self) -> float:
        """By how much the clock may be behind, in seconds: the edge, or the measured offset."""
        if self.offset is not None and self.state is ClockState.SYNCHRONISED:
            return min(-self.offset.least_s, self.edge_s)
        return self.edge_s

    def observe(self, stamp_ns: int, arrival_ns: int) -> None:
        """Add the times of a message.

        Parameters
        ----------
        stamp_ns
            By the publisher's clock, in nanoseconds since 1970.
        arrival_ns
            By this computer's clock.
        """
        if self._envelope is None:
            self._begin(stamp_ns, arrival_ns)
        delay_ns = arrival_ns - stamp_ns
        passed_s = (arrival_ns - self._first_arrival_ns) / NS_PER_S
        height_s = (delay_ns - self._first_delay_ns) / NS_PER_S
        delay_s = delay_ns / NS_PER_S
        self._newest_s = max(self._newest_s, passed_s)
        if height_s < self._lowest[1]:
            self._lowest = passed_s, height_s
        if passed_s - self._period_begin_s > _PERIOD_S and self._envelope is not None:
            # Only the lowest point of each second, because a fit takes longer than all other work.
            self._envelope.add(*self._lowest)
            self._lowest, self._period_begin_s = (0.0, math.inf), passed_s
        self._late.add(delay_s, WAY_S, passed_s)
        self._judge(delay_s)
        # If the clock was measured to be right, late messages are due to the network.
        is_right = self.state is ClockState.SYNCHRONISED and self.offset is None
        is_to_doubt = is_right or self._late.least > BEHIND_S
        if self.state in _NOT_WRONG and is_to_doubt and self._late.outlasts(SET_BACK):
            self.state = _late_state(self._late.least)
            self._begin(stamp_ns, arrival_ns)

    def _begin(self, stamp_ns: int, arrival_ns: int) -> None:
        self._first_delay_ns, self._first_arrival_ns = arrival_ns - stamp_ns, arrival_ns
        self._envelope, self._lowest = LowerEnvelope(0.0), (0.0, math.inf)
        self._newest_s = self._period_begin_s = 0.0
        self._late = LateRun()

    def look(self, now_ns: int) -> None:
        """Update the state by the elapsed time, also without new messages."""
        if self.is_in_doubt:
            passed_s = (now_ns - self._first_arrival_ns) / NS_PER_S
            if passed_s > PATIENCE_S:
                self.state = _late_state(self.edge_s)

    def take_offset(self, offset: Offset) -> None:
        """Store the measured offset of the publisher's clock."""
        self.offset = offset
        if offset.least_s > AHEAD_S or offset.most_s < -WAY_S:
            self.state = ClockState.WRONG
        elif offset.least_s >= -WAY_S and self.state is not ClockState.WRONG:
            self.state = ClockState.SYNCHRONISED

    def _judge(self, delay_s: float) -> None:
        if delay_s < -AHEAD_S:
            self.state = ClockState.WRONG
        elif self.state in (ClockState.UNKNOWN, ClockState.BEHIND):
            if delay_s <= WAY_S:
                self.state = ClockState.SYNCHRONISED
            elif self.state is ClockState.UNKNOWN and self._newest_s > PATIENCE_S:
                self.state = _late_state(self.edge_s)


_NOT_WRONG = (ClockState.SYNCHRONISED, ClockState.BEHIND)


def _late_state(edge_s: float) -> ClockState:
    return ClockState.BEHIND if edge_s <= BEHIND_S else ClockState.WRONG
