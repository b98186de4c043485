"""Time that passes when a test says so."""

from __future__ import annotations

from biosensor_gateway.system.clock import LslClock


class SetClock(LslClock):
    """Stands still until it is set.

    Attributes
    ----------
    now_s
        What it tells.
    """

    def __init__(self, now_s: float = 1000.0) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        """Return the time now, in seconds."""
        return self.now_s
