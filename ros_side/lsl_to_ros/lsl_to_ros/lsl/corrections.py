"""Remembers what was measured of a sender's clock."""

from __future__ import annotations

from collections import deque

KEPT = 10


class Corrections:
    """The last corrections for one sender.

    Attributes
    ----------
    newest
        Seconds to add to a stamp for this machine's LSL clock; None before the first
        measurement.
    """

    def __init__(self) -> None:
        self.newest: float | None = None
        self._recent: deque[float] = deque(maxlen=KEPT)

    @property
    def spread(self) -> float:
        """Largest minus smallest of the last ten, in seconds."""
        # Another thread may add one meanwhile.
        recent = list(self._recent)
        return max(recent) - min(recent) if recent else 0.0

    def add(self, correction: float) -> bool:
        """Take in a measurement; return whether it is the first."""
        is_first = self.newest is None
        self._recent.append(correction)
        self.newest = correction
        return is_first
