"""Faults of a virtual device: how a command line writes them, how they begin and end."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, unique
from operator import attrgetter
from typing import Any, Generic, TypeVar

import numpy as np

from biosensor_common.errors import ConfigError, ConfigReason, did_you_mean

# Time for which bytes wait for others; those after a split wait again.
_TOGETHER_S = 0.02
_LONGEST_TAIL = 24


@unique
class FaultKind(Enum):
    """Faults of a device, with the unit of the value in brackets."""

    DROP = "drop"
    """The link breaks and cannot be restored for this time [s]."""
    STALL = "stall"
    """The link stays, but nothing is sent or received for this time [s]."""
    GARBAGE = "garbage"
    """This many random bytes or damaged messages, if the transport can carry them."""
    REFUSE = "refuse"
    """The device breaks the link, then refuses every command for this time [s]."""
    DENY = "deny"
    """The device breaks the link, then refuses one of its signals for this time [s]."""
    REPEAT = "repeat"
    """It repeats the last beats of each packet in the next one, for this time [s]."""
    STEP_BACK = "step_back"
    """Its counts step back by this number, once."""
    LATE = "late"
    """The device breaks the link, then delays all answers by this time for 30 s [s]."""
    FORGET = "forget"
    """It stays connected but forgets what was enabled, and only sends keep-alive messages."""
    UNREADABLE = "unreadable"
    """Data have an unknown format, as from another version, for this time [s]."""
    RESTART = "restart"
    """The device or its server ends and restarts after this time [s]; all modes are lost."""
    LOW_BATTERY = "low_battery"
    """The battery has this much left [percent]."""
    OFF_BODY = "off_body"
    """The wearer takes the sensor off for this time [s]."""
    DRIFT = "drift"
    """The device's oscillator runs fast by this amount [ppm]."""


OF_A_KIND = frozenset({FaultKind.DENY, FaultKind.REPEAT, FaultKind.STEP_BACK})
"""Faults of some kinds of devices only; others need not give reasons for not having them."""


@unique
class Untidiness(Enum):
    """Disturbances of some kinds of devices that are not faults."""

    APART = "apart"
    """Sometimes a channel of a sensor is read one sample later than the others [s]."""
    OVERTAKEN = "overtaken"
    """Every third message arrives after the next one [s]."""
    GLUED = "glued"
    """Answers are joined in pairs and split at random places [s]."""
    RATE = "rate"
    """It restarts and measures at this rate, different from its settings [Hz]; for 30 s."""
    PACE = "pace"
    """It restarts, and one of its sensors is faster than declared by this much [%]; for 30 s."""
    BUNDLED = "bundled"
    """Its data are delayed by up to this time and arrive together [s]; for 30 s."""
    STRAY = "stray"
    """This many messages that resemble its own but are meaningless."""
    NAMELESS = "nameless"
    """It advertises no name [s]."""
    READDRESSED = "readdressed"
    """The link breaks and it changes its address [s]; then it breaks again to change back."""


@unique
class OfWearer(Enum):
    """Changes of the wearer instead of a device."""

    HEART_RATE = "hr"
    """The heart rate changes to this value within ten seconds [1/min]."""
    FLAT = "flat"
    """Electrodes, lights and belts of a device have one value for this time [s]."""


Kind = FaultKind | Untidiness | OfWearer
_UNITS: dict[Kind, str] = {
    FaultKind.GARBAGE: "",
    FaultKind.STEP_BACK: "",
    FaultKind.FORGET: "",
    FaultKind.LOW_BATTERY: "%",
    FaultKind.DRIFT: "ppm",
    Untidiness.RATE: "Hz",
    Untidiness.PACE: "%",
    Untidiness.STRAY: "",
    OfWearer.HEART_RATE: "bpm",
}
_DEFAULTS: dict[Kind, float] = {
    FaultKind.GARBAGE: 64.0,
    FaultKind.LOW_BATTERY: 4.0,
    FaultKind.DRIFT: 150.0,
    FaultKind.LATE: 1.0,
    FaultKind.STEP_BACK: 1.0,
    Untidiness.RATE: 100.0,
    Untidiness.PACE: 4.0,
    Untidiness.BUNDLED: 2.0,
    Untidiness.STRAY: 3.0,
    OfWearer.HEART_RATE: 120.0,
    OfWearer.FLAT: 30.0,
}
_KINDS: dict[str, Kind] = {kind.value: kind for kind in (*FaultKind, *Untidiness, *OfWearer)}
_RANGES: dict[Kind, tuple[float, float]] = {
    FaultKind.LOW_BATTERY: (0.0, 100.0),
    FaultKind.GARBAGE: (0.0, 1e6),
    Untidiness.STRAY: (0.0, 1e6),
    Untidiness.RATE: (1.0, 1000.0),
    Untidiness.PACE: (-50.0, 100.0),
    Untidiness.BUNDLED: (0.0, 60.0),
    # Range in which every sensor detects each beat exactly once.
    OfWearer.HEART_RATE: (30.0, 200.0),
    # Far more than any oscillator, and far less than one that stops.
    FaultKind.DRIFT: (-100_000.0, 100_000.0),
}
_SECONDS = "s"
_DEFAULT_SECONDS = 5.0
_FAULT = re.compile(
    r"(?:(?P<sensor>[a-z][a-z0-9_]*(?::[a-z][a-z0-9_]*)?):)?"
    rf"(?P<kind>{'|'.join(_KINDS)})"
    r"(?::(?P<value>-?[0-9]+(?:\.[0-9]+)?)(?P<unit>s|%|ppm|Hz|bpm)?)?"
    r"@(?P<start>[0-9]+(?:\.[0-9]+)?)s?"
)


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault."""

    kind: Kind
    value: float  # In the unit of the kind; infinite seconds never end.

    def __post_init__(self) -> None:
        low, high = _RANGES.get(self.kind, (0.0, math.inf))
        # NaN is not in any range.
        if not low <= self.value <= high:
            raise ValueError(f"a fault {self.kind.value} of {self.value:g} is not possible")


@dataclass(frozen=True, slots=True)
class ScheduledFault:
    """A fault with its start and the affected sensor."""

    fault: Fault
    start_s: float  # Seconds after the virtual devices were started.
    sensor: str = ""  # The affected sensor; empty for every device that can have the fault.


def parse_fault(text: str) -> ScheduledFault:
    """Parse a fault in command line notation.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, with the text and what is allowed.
    """
    found = _FAULT.fullmatch(text.strip())
    kind = _KINDS[found["kind"]] if found else None
    if found is None or kind is None or (found["unit"] or _unit(kind)) != _unit(kind):
        kinds = ", ".join(_KINDS)
        words = re.findall(r"\w+", text.partition("@")[0])
        hint = next(filter(None, (did_you_mean(each, _KINDS) for each in words)), "")
        message = (
            f"{text!r} is not a fault{hint}; write [SENSOR:]KIND[:VALUE]@START, such as drop:5s@10s"
        )
        raise ConfigError(ConfigReason.WRONG_VALUE, f"{message}; kinds are {kinds}")
    value = float(found["value"]) if found["value"] else _DEFAULTS.get(kind, _DEFAULT_SECONDS)
    try:
        fault = Fault(kind, value)
    except ValueError as error:
        raise ConfigError(ConfigReason.WRONG_VALUE, f"{text!r}: {error}") from error
    return ScheduledFault(fault, float(found["start"]), found["sensor"] or "")


def _unit(kind: Kind) -> str:
    return _UNITS.get(kind, _SECONDS)


_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Effect(Generic[_T]):
    """The effect of one kind of fault on a device or a part of it.

    Both functions run in the world's event loop and must not block.
    """

    begin: Callable[[_T, float], None]  # Called with the affected object and the fault's value.
    # Called with the affected object; None for instantaneous faults.
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


class Glue:
    """Passes bytes on unchanged, or joined and split; must run in the loop's thread.

    Parameters
    ----------
    send
        Accepts all bytes or nothing; returns which.
    """

    def __init__(self, send: Callable[[bytes], bool]) -> None:
        self._send = send
        self._rng = np.random.default_rng(0)
        self._held = bytearray()
        self._is_on = self._is_fresh = False
        self._turn: asyncio.TimerHandle | None = None

    def switch(self, *, on: bool) -> None:
        """Switch joining and splitting on or off."""
        self._is_on = on
        if not on:
            self.flush()

    def write(self, data: bytes) -> bool:
        """Accept all of ``data`` or nothing."""
        if not self._is_on:
            return self._send(data)
        # The first byte is sent now, which shows whether there is room and a listener.
        if not self._held and not self._send(data[:1]):
            return False
        self._held += data if self._held else data[1:]
        self._is_fresh = True
        if self._turn is None:
            self._turn = asyncio.get_running_loop().call_later(_TOGETHER_S, self._take_turn)
        return True

    def flush(self) -> None:
        """Send all waiting bytes."""
        held = bytes(self._held)
        self.forget()
        if held:
            self._send(held)

    def forget(self) -> None:
        """Discard all waiting bytes."""
        self._held.clear()
        if self._turn is not None:
            self._turn.cancel()
            self._turn = None

    def _take_turn(self) -> None:
        self._turn = None
        tail = int(self._rng.integers(_LONGEST_TAIL)) if self._is_fresh else 0
        goes = bytes(self._held[: max(1, len(self._held) - tail)])
        if goes and self._send(goes):
            del self._held[: len(goes)]
        self._is_fresh = False
        if self._held:
            self._turn = asyncio.get_running_loop().call_later(_TOGETHER_S, self._take_turn)


def glued(path: str) -> Effect[Any]:
    """Return the effect of switching a device's `glue` on, if it has a port."""
    port = attrgetter(path)

    def switch(hit: object, *, on: bool) -> None:
        if (found := port(hit)) is not None:
            found.glue(on=on)

    return lasting(lambda hit: switch(hit, on=True), lambda hit: switch(hit, on=False))
