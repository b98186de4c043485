"""Judges whether a stream's topics are published faster than subscribers take messages."""

from __future__ import annotations

from collections import deque
from time import monotonic

from lsl_to_ros.accounts.load import Hysteresis
from lsl_to_ros.accounts.rates import RATE_WINDOW_S

# Messages of one topic in a second. A subscriber in Python that has a core of its own takes
# 4000 to 6000; of 10 000 it lost a third, of 4000 a hundredth.
FAST_HZ, USUAL_HZ = 4000.0, 3000.0


class Outflow:
    """Follows the messages of one topic over the last 10 s."""

    def __init__(self) -> None:
        self.rate = 0.0
        self._points: deque[tuple[float, int, int]] = deque()
        self._fast = Hysteresis(FAST_HZ, USUAL_HZ)

    @property
    def is_fast(self) -> bool:
        """Whether it goes out faster than a usual subscriber takes it."""
        return self._fast.is_on

    def look(self, published: int, not_taken: int) -> int:
        """Take in a topic's counts; return by how much the second one grew in the last 10 s.

        The rate is in messages per second, 0 until the topic has been looked at for 10 s.
        """
        now, points = monotonic(), self._points
        if points and published < points[-1][1]:
            # Another topic's: the stream has moved.
            points.clear()
        points.append((now, published, not_taken))
        while len(points) > 1 and now - points[1][0] >= RATE_WINDOW_S:
            points.popleft()
        begun, first, untaken = points[0]
        elapsed = now - begun
        self.rate = (published - first) / elapsed if elapsed >= RATE_WINDOW_S else 0.0
        self._fast.judge(self.rate)
        return not_taken - untaken
