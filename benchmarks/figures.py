"""What a measurement says: figures, most with a target."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Target:
    """A limit of a figure; an upper one unless *at_least* is set."""

    limit: float
    at_least: bool = False

    def is_reached(self, value: float) -> bool:
        """Tell whether a figure is within the limit."""
        return value >= self.limit if self.at_least else value <= self.limit

    def __str__(self) -> str:
        return f"{'>=' if self.at_least else '<='} {self.limit:g}"


@dataclass(frozen=True, slots=True)
class Figure:
    """One number, as it came out."""

    title: str
    value: float
    unit: str
    target: Target | None = None
    note: str = ""

    @property
    def verdict(self) -> str:
        """Whether the target is reached; empty without a target."""
        if self.target is None:
            return ""
        return "reached" if self.target.is_reached(self.value) else "missed"


@dataclass(frozen=True, slots=True)
class Measurement:
    """Figures that belong together."""

    title: str
    figures: Sequence[Figure]
    # What the figures were made of, ready for JSON.
    details: Mapping[str, Any] = field(default_factory=dict[str, Any])
