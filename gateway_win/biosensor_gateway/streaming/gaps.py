"""Finds the span of LSL time in which samples are missing that a driver counts as lost."""

from __future__ import annotations

from collections.abc import Sequence

from biosensor_gateway.system.clock import Clock


class Gaps:
    """The newest sample of each stream of one device, and the step to it from the one before.

    Parameters
    ----------
    clock
        The LSL time; no sample is taken for newer.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._newest: dict[str, float] = {}
        self._steps: dict[str, tuple[float, float]] = {}

    def note(self, data_name: str, times: Sequence[float]) -> None:
        """Note samples at these LSL times, at least one."""
        newest = self._newest.get(data_name)
        if newest is not None:
            self._steps[data_name] = newest, times[0]
        self._newest[data_name] = min(max(times), self._clock())

    def widest(self, data_name: str) -> tuple[float, float]:
        """Return where samples that are counted as lost now are missing.

        Some drivers count them before they emit what follows the gap, some after: so it is
        the last step, or from the newest sample to now.
        """
        now = self._clock()
        newest = self._newest.get(data_name, now)
        spans = (newest, now), self._steps.get(data_name, (newest, newest))
        return max(spans, key=lambda span: span[1] - span[0])
