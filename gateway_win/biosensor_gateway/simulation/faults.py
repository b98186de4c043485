"""Faults that a virtual device can be given, and how a command line writes them.

``[SENSOR:]KIND[:VALUE]@START``, for instance ``drop:5s@10s`` (the link is gone for
five seconds, ten seconds after the start), ``polar_h10:off_body:20s@15s``,
``low_battery:4%@5s``, ``drift:150ppm@0s``, ``garbage:64@10s``; ``hr:120bpm@30s`` is no fault,
but happens to whoever wears it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import Enum, unique

from biosensor_common.errors import ConfigError, ConfigReason, did_you_mean


@unique
class FaultKind(Enum):
    """What can go wrong with a device; the value's unit is in brackets."""

    DROP = "drop"
    """The link breaks and cannot be had again for so long [s]."""
    STALL = "stall"
    """The link stands, but nothing is sent or heard for so long [s]."""
    GARBAGE = "garbage"
    """So many random bytes, or damaged messages, where the transport can carry them."""
    REFUSE = "refuse"
    """The device breaks the link, then refuses every command for so long [s]."""
    DENY = "deny"
    """The device breaks the link, then refuses one of its signals for so long [s]."""
    REPEAT = "repeat"
    """It tells the last beats of each packet in the next one again, for so long [s]."""
    STEP_BACK = "step_back"
    """What it counts steps back by so many, once."""
    LATE = "late"
    """The device breaks the link, then for 30 s answers every command so late [s]."""
    FORGET = "forget"
    """It stays connected and forgets what was switched on: only what keeps it alive still comes."""
    UNREADABLE = "unreadable"
    """Data come in a form that nobody can read, as of another version, for so long [s]."""
    RESTART = "restart"
    """The device or its server ends and starts again after so long [s]; all modes are lost."""
    LOW_BATTERY = "low_battery"
    """The battery has this much left [percent]."""
    OFF_BODY = "off_body"
    """The wearer takes the sensor off for so long [s]."""
    DRIFT = "drift"
    """The device's oscillator runs fast by so much [ppm]."""


OF_A_KIND = frozenset({FaultKind.DENY, FaultKind.REPEAT, FaultKind.STEP_BACK})
"""Only devices of some kinds can have these; the others need not say why they cannot."""


@unique
class Untidiness(Enum):
    """What devices of some kinds do besides, though nothing is wrong with them."""

    APART = "apart"
    """Now and then a channel of a sensor is read a sample later than the others [s]."""
    OVERTAKEN = "overtaken"
    """Each third message comes behind the next one [s]."""
    GLUED = "glued"
    """Answers come two at a time, and in pieces that are cut anywhere [s]."""
    RATE = "rate"
    """It starts again and measures so often, which is not what its settings say [Hz]; for 30 s."""
    BUNDLED = "bundled"
    """What it sends waits for so long and comes together [s]; for 30 s."""
    STRAY = "stray"
    """So many messages that are like its own, and mean nothing."""
    NAMELESS = "nameless"
    """It advertises no name [s]."""
    READDRESSED = "readdressed"
    """The link breaks, and it has another address [s]; then again, back to its own."""


@unique
class OfWearer(Enum):
    """What happens to the person, and to no device."""

    HEART_RATE = "hr"
    """The heart comes to beat so often, within ten seconds [1/min]."""


Kind = FaultKind | Untidiness | OfWearer

_UNITS: dict[Kind, str] = {
    FaultKind.GARBAGE: "",
    FaultKind.STEP_BACK: "",
    FaultKind.FORGET: "",
    FaultKind.LOW_BATTERY: "%",
    FaultKind.DRIFT: "ppm",
    Untidiness.RATE: "Hz",
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
    Untidiness.BUNDLED: 2.0,
    Untidiness.STRAY: 3.0,
    OfWearer.HEART_RATE: 120.0,
}
_KINDS: dict[str, Kind] = {kind.value: kind for kind in (*FaultKind, *Untidiness, *OfWearer)}
_RANGES: dict[Kind, tuple[float, float]] = {
    FaultKind.LOW_BATTERY: (0.0, 100.0),
    FaultKind.GARBAGE: (0.0, 1e6),
    Untidiness.STRAY: (0.0, 1e6),
    Untidiness.RATE: (1.0, 1000.0),
    Untidiness.BUNDLED: (0.0, 60.0),
    # In which a beat is one beat to every sensor.
    OfWearer.HEART_RATE: (30.0, 200.0),
    # Far beyond any oscillator, and far from one that stands still.
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
    """One fault.

    Attributes
    ----------
    value
        In the unit of the kind; for those in seconds, infinity never ends.
    """

    kind: Kind
    value: float

    def __post_init__(self) -> None:
        low, high = _RANGES.get(self.kind, (0.0, math.inf))
        # NaN is in no range.
        if not low <= self.value <= high:
            raise ValueError(f"a fault {self.kind.value} of {self.value:g} makes no sense")


@dataclass(frozen=True, slots=True)
class ScheduledFault:
    """A fault, when it begins and whom it hits.

    Attributes
    ----------
    start_s
        Seconds after the virtual devices were started.
    sensor
        Only this one; empty for every device that can have the fault.
    """

    fault: Fault
    start_s: float
    sensor: str = ""


def parse_fault(text: str) -> ScheduledFault:
    """Read a fault as the command line has it.

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
            f"{text!r} is no fault{hint}; write [SENSOR:]KIND[:VALUE]@START, as in drop:5s@10s"
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
