"""Measures how fast a stream advances, from one status of the agent to the next."""

from __future__ import annotations

from collections import deque

RATE_OVER_S = 10.0
"""A rate is measured over so long, by the samples' own times."""
STALE_AFTER_S = 5.0
"""Samples of some devices come in lumps of seconds; later, there is no rate any more."""


class RateMeter:
    """Measures one stream by the stamps of its samples."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, float]] = deque()

    def note(self, pushed: int, last_stamp: float) -> None:
        """Take in a count, and the LSL time of the newest of those samples."""
        if self._seen and pushed < self._seen[-1][0]:
            self._seen.clear()
        if not self._seen or pushed > self._seen[-1][0]:
            self._seen.append((pushed, last_stamp))
            # Nobody need ask for the rate, as of a stream that has none.
            self._forget(last_stamp)

    def rate_hz(self, now: float) -> float | None:
        """Return the rate at an LSL time; None while nothing comes."""
        self._forget(now)
        if not self._seen or now - self._seen[-1][1] > STALE_AFTER_S:
            self._seen.clear()
            return None
        (first, since), (newest, until) = self._seen[0], self._seen[-1]
        return (newest - first) / (until - since) if until > since else None

    def _forget(self, now: float) -> None:
        while len(self._seen) > 2 and now - self._seen[0][1] > RATE_OVER_S:
            self._seen.popleft()
