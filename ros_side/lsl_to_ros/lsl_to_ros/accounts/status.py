"""Follows a stream's rate, silences and losses over the last seconds."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from time import monotonic

from lsl_to_ros.accounts.load import Backlog
from lsl_to_ros.accounts.outflow import Outflow
from lsl_to_ros.accounts.rates import RATE_WINDOW_S, RateMeter


@dataclass(slots=True)
class StreamStatus:
    """What the reports of one stream remember from one to the next."""

    meter: RateMeter = field(default_factory=RateMeter)
    begun_s: float = field(default_factory=monotonic)
    troubles: deque[tuple[float, int, int]] = field(default_factory=deque[tuple[float, int, int]])
    received: int = 0
    heard_s: float = field(default_factory=monotonic)
    backlog: Backlog = field(default_factory=Backlog)
    outflow: Outflow = field(default_factory=Outflow)
    oldest_s: float = 0.0

    def waited(self, age_s: float) -> None:
        """Take note for how long something has waited at this moment."""
        self.oldest_s = max(self.oldest_s, age_s)

    def take_oldest(self) -> float:
        """Return the longest of these since the last call, in seconds."""
        oldest_s, self.oldest_s = self.oldest_s, 0.0
        return oldest_s

    def silence(self, received: int) -> float:
        """Take in the count of samples; return for how many seconds it has stood still."""
        now = monotonic()
        if received != self.received:
            self.received, self.heard_s = received, now
        return now - self.heard_s

    def recent(self, lost: int, unfit: int) -> tuple[int, int]:
        """Take in the present counts; return how much they grew in the last 10 s."""
        now = monotonic()
        self.troubles.append((now, lost, unfit))
        while now - self.troubles[0][0] > RATE_WINDOW_S:
            self.troubles.popleft()
        return lost - self.troubles[0][1], unfit - self.troubles[0][2]
