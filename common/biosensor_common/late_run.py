"""Tells packets that stay late from such as are late for a while."""

from __future__ import annotations

import math
from dataclasses import dataclass

SAME_MOMENT_S = 0.002


@dataclass(frozen=True, slots=True)
class Patience:
    """For how long late packets pass for a stall, once they are not less and less late.

    Attributes
    ----------
    seconds : float
        They have come over so many seconds, at least.
    observations : int
        They came at so many moments, at least: what waited together comes at one.
    spread : float
        The earliest packets of each second differ by no more than this part of their least
        lateness: after a clock was set all are late by the same time, after a stall they are not.
    """

    seconds: float
    observations: int
    spread: float = math.inf


class LateRun:
    """The present run of packets that are late, without a timely one in between.

    Attributes
    ----------
    began_behind : bool
        The first of them was measured long before others that had come already.
    least : float
        Least lateness of them, in seconds; infinite if no packet is late.
    """

    def __init__(self) -> None:
        self.began_behind = False
        self.least = math.inf
        self._since = self._until = self._second = math.nan
        self._count = 0
        self._least_of_second = math.inf
        self._largest_least = -math.inf
        # Of the packet with which patience began.
        self._settled = math.inf

    def add(self, late_s: float, limit_s: float, arrival_s: float, *, behind: bool = False) -> None:
        """Take in a packet; one that is not late by more than the limit ends the run.

        One that is less late than all before it, by more than the limit, is of a backlog that
        catches up: patience begins again with it.
        """
        if late_s <= limit_s:
            self.least = math.inf
            self._count = 0
            return
        if self._count == 0:
            self.began_behind = behind
            self._second, self._settled = arrival_s, math.inf
            self._least_of_second, self._largest_least = math.inf, -math.inf
        elif arrival_s - self._second >= 1.0:
            self._largest_least = max(self._largest_least, self._least_of_second)
            self._second, self._least_of_second = arrival_s, math.inf
        if late_s < self._settled - limit_s:
            self._settled, self._since, self._count = late_s, arrival_s, 0
        # After a clock was set, packets come one by one as ever.
        if self._count == 0 or arrival_s > self._until + SAME_MOMENT_S:
            self._count += 1
        self._until = arrival_s
        self._least_of_second = min(self._least_of_second, late_s)
        self.least = min(self.least, late_s)

    def outlasts(self, patience: Patience) -> bool:
        """Whether this is no stall any more."""
        return (
            self._count >= patience.observations
            and self._until - self._since >= patience.seconds
            and self._largest_least - self.least <= patience.spread * self.least
        )
