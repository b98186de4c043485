"""Begins and ends faults of a virtual device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Generic, TypeVar

from biosensor_gateway.simulation.faults import FaultKind, Kind

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


def on_part(path: str, effects: Effects[Any]) -> dict[Kind, Effect[Any]]:
    """Return the effects on a device of which one part is hit.

    Parameters
    ----------
    path
        Names from the device to the part, with dots between.
    effects
        Those on the part.
    """
    part = attrgetter(path)

    def on(effect: Effect[Any]) -> Effect[Any]:
        begin, end = effect.begin, effect.end
        return Effect(
            lambda device, value: begin(part(device), value),
            None if end is None else lambda device: end(part(device)),
        )

    return {kind: on(effect) for kind, effect in effects.items()}


def flag(
    path: str, value: bool = True, *, then: Callable[[Any], None] | None = None
) -> Effect[Any]:
    """Return the effect that an attribute has a value for as long as the fault lasts.

    Parameters
    ----------
    path
        Names from what is hit to the attribute, with dots between; without effect where one on
        the way is None.
    value
        During the fault; the opposite afterwards.
    then
        Called with what is hit once the fault has begun, to break a link for instance.
    """

    def begin(hit: object, _: float) -> None:
        _set(hit, path, value)
        if then is not None:
            then(hit)

    return Effect(begin, lambda hit: _set(hit, path, not value))


def level(
    path: str,
    usual: float | None = None,
    *,
    read: Callable[[float], float] = float,
    then: Callable[[Any], None] | None = None,
) -> Effect[Any]:
    """Return the effect that an attribute has the value of the fault.

    Parameters
    ----------
    usual
        Its value afterwards; None where the fault happens once.
    read
        Makes the attribute's value of the fault's.
    path, then
        As of `flag`.
    """

    def begin(hit: object, value: float) -> None:
        _set(hit, path, read(value))
        if then is not None:
            then(hit)

    return Effect(begin, None if usual is None else lambda hit: _set(hit, path, usual))


def restart(path: str) -> Effect[Any]:
    """Return the effect that a `PowerSwitch` holds a device off, and switches it on again."""
    switch, kind = attrgetter(path), FaultKind.RESTART
    return lasting(lambda hit: switch(hit).hold_off(kind), lambda hit: switch(hit).release(kind))


def _set(hit: object, path: str, value: object) -> None:
    *way, last = path.split(".")
    for name in way:
        hit = getattr(hit, name)
        if hit is None:
            return
    getattr(hit, last)  # a misspelt name is an error, not a new attribute
    setattr(hit, last, value)
