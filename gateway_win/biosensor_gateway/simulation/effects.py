"""Begins and ends faults of a virtual device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from biosensor_gateway.simulation.faults import Kind

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Effect(Generic[_T]):
    """What one kind of fault does to a device, or to a part of one.

    Both functions run in the world's loop and must not block.

    Attributes
    ----------
    begin
        Takes what is hit, and the fault's value.
    end
        Takes what is hit; None for what happens at once.
    """

    begin: Callable[[_T, float], None]
    end: Callable[[_T], None] | None = None


Effects = Mapping[Kind, Effect[_T]]
"""By kind, for each fault that something can have."""


def lasting(begin: Callable[[_T], None], end: Callable[[_T], None]) -> Effect[_T]:
    """Return the effect of a fault whose value says only how long it lasts."""
    return Effect(lambda hit, _: begin(hit), end)


def on_part(name: str, effects: Effects[Any]) -> dict[Kind, Effect[Any]]:
    """Return the effects on a device of which one part is hit.

    Parameters
    ----------
    name
        Attribute of the device that holds the part.
    effects
        Those on the part.
    """
    return {kind: _on_part(name, effect) for kind, effect in effects.items()}


def _on_part(name: str, effect: Effect[Any]) -> Effect[Any]:
    def begin(device: object, value: float) -> None:
        effect.begin(getattr(device, name), value)

    def end(device: object) -> None:
        if effect.end is not None:
            effect.end(getattr(device, name))

    return Effect(begin, None if effect.end is None else end)
