"""Tracks a stream's rate, silences and losses over the last seconds."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from time import monotonic
from typing import NamedTuple

from lsl_to_ros.statistics.load import Backlog, Hysteresis

RATE_WINDOW_S = 10.0


class RateMeter:
    """Mean rate over the last seconds, from a growing count.

    Samples come in packets, so the newest sample's time is used, not the time of the
    call: at 250 Hz in packets of 63 the difference is 2 percent.
    """

    def __init__(self) -> None:
        self._points: deque[_Point] = deque()

    def rate(self, count: int, newest_s: float) -> float:
        """Add the present count and the newest sample's time; return samples per second."""
        now = monotonic()
        if newest_s and (not self._points or count != self._points[-1].samples):
            self._points.append(_Point(now, count, newest_s))
        while self._points and now - self._points[0].seen_s > RATE_WINDOW_S:
            self._points.popleft()
        if len(self._points) < 2:
            return 0.0
        first, last = self._points[0], self._points[-1]
        elapsed = last.newest_s - first.newest_s
        return (last.samples - first.samples) / elapsed if elapsed > 0 else 0.0


class _Point(NamedTuple):
    seen_s: float
    samples: int
    newest_s: float


# Messages of one topic per second. A subscriber in Python with a core to itself receives
# 4000 to 6000; of 10 000 it lost a third, of 4000 a hundredth.
FAST_HZ, USUAL_HZ = 4000.0, 3000.0


class PublishingRate:
    """Tracks the published messages of one topic over the last 10 s."""

    def __init__(self) -> None:
        self.rate = 0.0
        self._points: deque[tuple[float, int, int]] = deque()
        self._fast = Hysteresis(FAST_HZ, USUAL_HZ)

    @property
    def is_fast(self) -> bool:
        """Whether it is published faster than a usual subscriber receives it."""
        return self._fast.is_on

    def look(self, published: int, not_taken: int) -> int:
        """Add a topic's counts; return by how much the second one grew in the last 10 s.

        The rate is in messages per second, 0 for the first 10 s of a topic.
        """
        now, points = monotonic(), self._points
        if points and published < points[-1][1]:
            # Smaller counts belong to another topic: the stream was renamed.
            points.clear()
        points.append((now, published, not_taken))
        while len(points) > 1 and now - points[1][0] >= RATE_WINDOW_S:
            points.popleft()
        begun, first, untaken = points[0]
        elapsed = now - begun
        self.rate = (published - first) / elapsed if elapsed >= RATE_WINDOW_S else 0.0
        self._fast.judge(self.rate)
        return not_taken - untaken


@dataclass(slots=True)
class StreamStatus:
    """State of one stream's reports from one to the next."""

    meter: RateMeter = field(default_factory=RateMeter)
    begun_s: float = field(default_factory=monotonic)
    troubles: deque[tuple[float, int, int]] = field(default_factory=deque[tuple[float, int, int]])
    received: int = 0
    heard_s: float = field(default_factory=monotonic)
    backlog: Backlog = field(default_factory=Backlog)
    publishing: PublishingRate = field(default_factory=PublishingRate)
    oldest_s: float = 0.0

    def waited(self, age_s: float) -> None:
        """Record the present age of waiting data."""
        self.oldest_s = max(self.oldest_s, age_s)

    def take_oldest(self) -> float:
        """Return the largest recorded age since the last call, in seconds."""
        oldest_s, self.oldest_s = self.oldest_s, 0.0
        return oldest_s

    def silence(self, received: int) -> float:
        """Add the count of samples; return for how many seconds it has not changed."""
        now = monotonic()
        if received != self.received:
            self.received, self.heard_s = received, now
        return now - self.heard_s

    def recent(self, lost: int, unfit: int) -> tuple[int, int]:
        """Add the present counts; return how much they grew in the last 10 s."""
        now = monotonic()
        self.troubles.append((now, lost, unfit))
        while now - self.troubles[0][0] > RATE_WINDOW_S:
            self.troubles.popleft()
        return lost - self.troubles[0][1], unfit - self.troubles[0][2]
