"""Holds back what was measured while a device was paused.

A pause is a participant's withdrawal. So it is decided by the time at which a
sample was *measured*, not by the time at which it is handled: what was still in
work when the pause ended is held back as well.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence

RESUME_GUARD_S = 1.0
"""A stamp is later than the measurement, by the smallest delay of the device and its radio.

That delay is unknown and well below this, so what is stamped later was measured later.
"""
_REMEMBERED = 64


class PauseGate:
    """Decides by its stamp whether a sample may be sent. All times are LSL times in seconds.

    Attributes
    ----------
    since
        Unix time in s at which the pause began, for people; None without one.
    """

    def __init__(self) -> None:
        self._send_from = -math.inf
        self._began = math.nan
        self.since: float | None = None
        # nothing is dropped: these are times
        self._pauses: deque[tuple[float, float]] = deque(maxlen=_REMEMBERED)

    @property
    def is_on(self) -> bool:
        """Whether there is a pause now."""
        return self._send_from == math.inf

    @property
    def send_from(self) -> float:
        """What was measured before is not sent; infinite during a pause."""
        return self._send_from

    def begin(self, now: float, since: float | None = None) -> None:
        """Begin a pause; nothing happens during one.

        Parameters
        ----------
        since
            Unix time in s at which it was asked for, if that was earlier.
        """
        if not self.is_on:
            self.since = time.time() if since is None else since
            self._began = now
            self._send_from = math.inf

    def end(self, now: float) -> None:
        """End the pause, if there is one."""
        if self.is_on:
            self.since = None
            self._send_from = now + RESUME_GUARD_S
            self._pauses.append((self._began, self._send_from))

    def may_send(self, stamps: Sequence[float]) -> list[bool]:
        """Tell for each stamp whether a sample that was measured then may be sent."""
        if self._send_from == math.inf:
            return [False] * len(stamps)
        # A stamp that is no number is refused elsewhere, and said.
        return [not stamp < self._send_from for stamp in stamps]

    def share(self, begin: float, end: float) -> float:
        """Return which part of a span of time was paused, 0 to 1."""
        ongoing = [(self._began, end)] if self.is_on else []
        if not end > begin:
            return float(any(since <= end <= until for since, until in (*self._pauses, *ongoing)))
        paused_s = sum(
            max(0.0, min(end, until) - max(begin, since))
            for since, until in (*self._pauses, *ongoing)
        )
        return min(1.0, paused_s / (end - begin))
