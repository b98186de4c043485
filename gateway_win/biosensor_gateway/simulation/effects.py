"""Defines the effects of faults on virtual devices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Generic, TypeVar

from biosensor_gateway.simulation.faults import FaultKind, Kind

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Effect(Generic[_T]):
    """The effect of one kind of fault on a device or a part of it.

    Both functions run in the world's event loop and must not block.

    Attributes
    ----------
    begin
        Called with the affected object and the fault's value.
    end
        Called with the affected object; None for instantaneous faults.
    """

    begin: Callable[[_T, float], None]
    end: Callable[[_T], None] | None = None


Effects = Mapping[Kind, Effect[_T]]
"""Effects of all possible faults by kind."""


def lasting(begin: Callable[[_T], None], end: Callable[[_T], None]) -> Effect[_T]:
    """Return the effect of a fault whose value is only its duration."""
    return Effect(lambda hit, _: begin(hit), end)


def on_part(path: str, effects: Effects[Any]) -> dict[Kind, Effect[Any]]:
    """Return the effects on a device from those on one of its parts.

    Parameters
    ----------
    path
        Attribute path from the device to the part, with dots.
    effects
        Effects on the part.
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
    """Return the effect of setting an attribute for the duration of the fault.

    Parameters
    ----------
    path
        Attribute path from the affected object, with dots; no effect if an object on the path is
        None.
    value
        Value during the fault; the opposite is set afterwards.
    then
        Called with the affected object after the start, for example to break a link.
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
    """Return the effect of setting an attribute to the fault's value.

    Parameters
    ----------
    usual
        Value to set afterwards; None for instantaneous faults.
    read
        Converts the fault's value to the attribute's.
    path, then
        As for `flag`.
    """

    def begin(hit: object, value: float) -> None:
        _set(hit, path, read(value))
        if then is not None:
            then(hit)

    return Effect(begin, None if usual is None else lambda hit: _set(hit, path, usual))


def restart(path: str) -> Effect[Any]:
    """Return the effect of switching a device off and on with its `PowerSwitch`."""
    switch, kind = attrgetter(path), FaultKind.RESTART
    return lasting(lambda hit: switch(hit).hold_off(kind), lambda hit: switch(hit).release(kind))


def _set(hit: object, path: str, value: object) -> None:
    *way, last = path.split(".")
    for name in way:
        hit = getattr(hit, name)
        if hit is None:
            return
    getattr(hit, last)  # raises an error for a misspelt name
    setattr(hit, last, value)
