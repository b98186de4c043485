"""Follows a stream's rate, silences and losses over the last seconds."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from time import monotonic

from lsl_to_ros.accounts.rates import RATE_WINDOW_S, RateMeter


@dataclass(slots=True)
class StreamHealth:
    """What the reports of one stream remember from one to the next."""

    meter: RateMeter = field(default_factory=RateMeter)
    begun_s: float = field(default_factory=monotonic)
    troubles: deque[tuple[float, int, int]] = field(default_factory=deque[tuple[float, int, int]])
    received: int = 0
    heard_s: float = field(default_factory=monotonic)

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
