"""Measures the rate of a stream from the agent's successive statuses."""

from __future__ import annotations

from collections import deque

from biosensor_common.stream_header import stale_after_s

RATE_OVER_S = 10.0
"""Interval over which a rate is measured, by the samples' stamps."""


class RateMeter:
    """Measures the rate of one stream by the stamps of its samples.

    Parameters
    ----------
    nominal_hz
        Nominal rate; 0 if there is none.
    """

    def __init__(self, nominal_hz: float = 0.0) -> None:
        self._stale_after_s = stale_after_s(nominal_hz)
        self._seen: deque[tuple[int, float]] = deque()

    def note(self, pushed: int, last_stamp: float) -> None:
        """Take the number of samples so far, and the LSL time of the newest of them."""
        # A smaller count is that of a restarted agent.
        if self._seen and pushed < self._seen[-1][0]:
            self._seen.clear()
        if not self._seen or pushed > self._seen[-1][0]:
            self._seen.append((pushed, last_stamp))
            # Not only in `rate_hz`, which may never be called for this stream.
            self._forget(last_stamp)

    def rate_hz(self, now: float) -> float | None:
        """Return the rate at an LSL time; None while no samples are received."""
        self._forget(now)
        if not self._seen or now - self._seen[-1][1] > self._stale_after_s:
            self._seen.clear()
            return None
        (first, since), (newest, until) = self._seen[0], self._seen[-1]
        return (newest - first) / (until - since) if until > since else None

    def _forget(self, now: float) -> None:
        while len(self._seen) > 2 and now - self._seen[0][1] > RATE_OVER_S:
            self._seen.popleft()
