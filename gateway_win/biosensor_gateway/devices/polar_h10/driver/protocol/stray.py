"""Knows frames that came before, and those that others have overtaken."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from typing import NamedTuple

LATE_S = 5.0
"""A stamp that is older than that was made by a clock that was set."""
_KEPT = 64
_NS = 1_000_000_000


class SeenFrame(NamedTuple):
    """What tells a frame from others."""

    series: Hashable
    timestamp_ns: int
    content: int


class StrayFrames:
    """Those of all measurements of a connection; reported in polar-ble-sdk #387.

    Attributes
    ----------
    newest_ns
        Stamp of the newest frame that went on, by series.
    seen
        The last ones that went on.
    was_late
        Whether the last frame was left out because it was late.
    """

    def __init__(self) -> None:
        self.newest_ns: dict[Hashable, int] = {}
        # nothing is dropped: a memory
        self.seen: deque[SeenFrame] = deque(maxlen=_KEPT)
        self.was_late = False

    def why(self, frame: SeenFrame) -> str:
        """Return why a frame is to be left out that does not follow the newest; a clause.

        Empty if it goes on. Two late ones in a row are of a clock that was set back.
        """
        if frame in self.seen:
            return "they came twice"
        behind_ns = self.newest_ns[frame.series] - frame.timestamp_ns
        if 0 < behind_ns < LATE_S * _NS and not self.was_late:
            self.was_late = True
            return "they came behind later ones, and are counted as lost"
        self.seen.clear()
        return ""
