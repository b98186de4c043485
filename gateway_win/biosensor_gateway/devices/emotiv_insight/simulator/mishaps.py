"""Drops, repeats and spoils single EEG samples."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from biosensor_gateway.devices.emotiv_insight.simulator.signals import Sample


@dataclass(slots=True)
class Mishaps:
    """What befalls the next EEG samples; the numbers count down.

    Attributes
    ----------
    unannounced
        Samples of every stream have a column that no subscription told of.
    lost
        Are not sent.
    interpolated
        Are marked as filled in.
    repeated
        Are sent twice.
    markers
        Objects that go with one sample each.
    """

    unannounced: bool = False
    lost: int = 0
    interpolated: int = 0
    repeated: int = 0
    markers: deque[dict[str, Any]] = field(default_factory=deque[dict[str, Any]])

    def lose(self, count: int) -> None:
        """Send none of the next samples."""
        self.lost += count

    def interpolate(self, count: int) -> None:
        """Mark the next samples as filled in."""
        self.interpolated += count

    def repeat(self, count: int) -> None:
        """Send each of the next samples twice."""
        self.repeated += count

    def mark(self, label: str, value: int) -> None:
        """Put a marker into the next sample."""
        self.markers.append(
            {"extras": {}, "isStop": False, "label": label, "port": "Software",
             "type": "instance", "value": value}
        )  # fmt: skip

    def alter(self, sample: Sample) -> Sample:
        """Mark a sample as it has to be."""
        if self.interpolated:
            self.interpolated -= 1
            sample = sample | {"INTERPOLATED": 1}
        if self.markers:
            sample = sample | {"MARKER_HARDWARE": 1, "MARKERS": [self.markers.popleft()]}
        return sample

    def loses(self) -> bool:
        """Tell whether the next sample gets lost."""
        lost = self.lost > 0
        self.lost -= lost
        return lost

    def copies(self) -> int:
        """How many times the next sample is sent."""
        repeated = self.repeated > 0
        self.repeated -= repeated
        return 1 + repeated
