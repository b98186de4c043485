"""What each sensor can suffer, where it shows, and how it counts what it lost."""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType
from typing import NamedTuple

from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.simulation.faults import FaultKind


class AgentFault(Enum):
    """What happens to the agent, and so to all devices at once."""

    ASLEEP = "asleep"
    """It does not run for a while, as on a computer that sleeps or is starved."""


Kind = FaultKind | AgentFault
KINDS: tuple[Kind, ...] = (*FaultKind, *AgentFault)

SENSORS = (
    "empatica_e4",
    "emotiv_insight",
    "shimmer3_gsr",
    "polar_h10",
    "vernier_respiration_belt",
    "zephyr",
    "ble_heart_rate",
)
# A strap without a control point takes no commands that it could refuse or answer late.
_IMPOSSIBLE = frozenset({(FaultKind.REFUSE, "ble_heart_rate"), (FaultKind.LATE, "ble_heart_rate")})
CELLS = tuple((kind, name) for kind in KINDS for name in SENSORS if (kind, name) not in _IMPOSSIBLE)
BREAKS = frozenset(
    {FaultKind.DROP, FaultKind.STALL, FaultKind.REFUSE, FaultKind.LATE, FaultKind.RESTART}
)
"""The connection ends with these, and has to be made anew."""
MAY_BREAK = BREAKS | {AgentFault.ASLEEP}
"""The connection may end with these."""
AT_ONCE = frozenset({FaultKind.GARBAGE, FaultKind.LOW_BATTERY, FaultKind.DRIFT, FaultKind.FORGET})
"""There is no end to wait for."""
TOGETHER: tuple[Kind, ...] = (FaultKind.OFF_BODY, FaultKind.LOW_BATTERY, FaultKind.DRIFT)
"""They break nothing and each shows elsewhere, so they share the minute that some take:
belt and Shimmer are asked for their battery once a minute."""
VALUES = MappingProxyType(
    {
        FaultKind.GARBAGE: 64.0,
        FaultKind.LATE: 1.0,
        FaultKind.LOW_BATTERY: 4.0,
        FaultKind.DRIFT: 150.0,
    }
)
"""Of those whose value is no duration; all others last until they are ended."""


class Channel(NamedTuple):
    """One channel of a stream, and what it holds while the device is not worn."""

    data_name: str
    channel: int
    off: float = 0.0


WEAR = MappingProxyType(
    {name: Channel("quality", 0) for name in SENSORS}
    | {
        # The contact of all electrodes together, in percent.
        "emotiv_insight": Channel("dev", 7),
        # A belt that nobody wears is loose.
        "vernier_respiration_belt": Channel("quality", 1, -1.0),
    }
)
BATTERY = MappingProxyType(
    {name: Channel("bat", 0) for name in SENSORS} | {"emotiv_insight": Channel("dev", 8)}
)
BATTERY_TOLERANCE = 1.0
"""Of a percentage: a Shimmer computes it from a voltage of 12 bits."""
NO_VALUE = MappingProxyType(
    {
        "empatica_e4": ("gsr",),
        "emotiv_insight": ("met",),
        "shimmer3_gsr": ("gsr",),
        "polar_h10": ("hr", "ibi"),
        "vernier_respiration_belt": ("bpm",),
        "zephyr": ("hr", "br"),
        "ble_heart_rate": ("hr", "ibi"),
    }
)
"""Without contact these have none: NaN in its place if they are regular, else nothing."""
OF_THE_AGENT = frozenset({("shimmer3_gsr", "hr"), *((name, "quality") for name in SENSORS)})
"""The agent computes these, or decides when to send them: no truth of the wire."""
# Only older firmware than that of the virtual headset sends it.
_ABSENT = frozenset({("emotiv_insight", "gyro")})


class Gap(Enum):
    """What a device did while it was not connected, as far as a host can know."""

    MEASURED = "measured"
    """All that the gap had room for is lost."""
    STOPPED = "stopped"
    """Nothing is lost but what was on its way."""
    UNKNOWN = "unknown"
    """It stopped at some moment in the gap."""


_GAPS: MappingProxyType[tuple[Kind, str], Gap] = MappingProxyType(
    {
        # Its radio link stayed: it stops only when the host closes the port, in silence.
        (FaultKind.STALL, "shimmer3_gsr"): Gap.UNKNOWN,
        # Firmware stops streaming with the end of the link.
        **{(kind, "shimmer3_gsr"): Gap.STOPPED for kind in BREAKS - {FaultKind.STALL}},
        # Cortex lets go of the headset, the strap is switched off: neither measures.
        (FaultKind.RESTART, "emotiv_insight"): Gap.STOPPED,
        # It answers and sends nothing: whether it measures, nobody knows.
        (FaultKind.FORGET, "shimmer3_gsr"): Gap.UNKNOWN,
        (FaultKind.RESTART, "polar_h10"): Gap.STOPPED,
    }
)


def gap_of(kind: Kind, name: str) -> Gap:
    """What a fault makes of a device's measuring."""
    return _GAPS.get((kind, name), Gap.MEASURED)


_PACKETS = MappingProxyType({"ecg": 63, "breathing": 18, "acc": 20})
_WRISTBAND = MappingProxyType({"bvp": 4, "acc": 2, "gsr": 6, "st": 6})


def tolerance(kind: Kind, name: str, data_name: str) -> int:
    """By how many samples the count of those that are lost may be wrong.

    A wristband's loss is a time, told to 0.05 s, and some of its samples come six at a
    time. What else is lost without a break of the connection is counted exactly, and over
    a break what a headset or a BioHarness numbers and stamps; but after a restart the
    BioHarness measures between two packets, which are what it numbers. Belt and strap
    begin a new series at each connection, which is placed by time. A Shimmer may have
    samples in its radio when that breaks.
    """
    if name == "empatica_e4":
        return _WRISTBAND[data_name]
    if kind not in MAY_BREAK | {FaultKind.FORGET}:
        return 0
    if name == "zephyr":
        return _PACKETS[data_name] if kind is FaultKind.RESTART else 0
    return {"emotiv_insight": 0, "shimmer3_gsr": 4}.get(name, 2)


def numeric_streams(name: str) -> tuple[str, ...]:
    """Data names of all streams of numbers that a sensor has."""
    streams = (each for each in declaration(name).streams if not each.message_type.is_text)
    return tuple(each.data_name for each in streams if (name, each.data_name) not in _ABSENT)


def regular_streams(name: str) -> tuple[str, ...]:
    """Data names of those that come at a rate."""
    return tuple(each for each in numeric_streams(name) if declaration(name).stream(each).rate != 0)


def steady_streams(name: str) -> tuple[str, ...]:
    """Data names of those that never pause, by which one knows that a device streams."""
    # A heart-rate strap has no regular stream, but says once a second whether it is worn.
    return regular_streams(name) or ("quality",)


def unit_of(name: str) -> str:
    """How the settings call the device."""
    return name.upper()


def source(name: str, data_name: str) -> str:
    """The source_id of a stream."""
    return source_id(DeviceIdentity(name, unit_of(name)), data_name)
