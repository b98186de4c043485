"""What each sensor can suffer, where it shows, and how it counts what it lost."""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType
from typing import NamedTuple

from biosensor_common.naming import source_id
from biosensor_common.registry import sensor
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.simulation.faults import FaultKind

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
_IMPOSSIBLE = frozenset(
    {(FaultKind.REFUSE, "ble_heart_rate"), (FaultKind.LATE, "ble_heart_rate")}
)
CELLS = tuple(
    (kind, name) for kind in FaultKind for name in SENSORS if (kind, name) not in _IMPOSSIBLE
)
BREAKS = frozenset(
    {FaultKind.DROP, FaultKind.STALL, FaultKind.REFUSE, FaultKind.LATE, FaultKind.RESTART}
)
"""The connection ends with these, and has to be made anew."""
AT_ONCE = frozenset({FaultKind.GARBAGE, FaultKind.LOW_BATTERY, FaultKind.DRIFT})
"""There is no end to wait for."""
TOGETHER = (FaultKind.OFF_BODY, FaultKind.LOW_BATTERY, FaultKind.DRIFT)
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
    index: int
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


_GAPS = MappingProxyType(
    {
        # Its radio link stayed: it stops only when the host closes the port, in silence.
        (FaultKind.STALL, "shimmer3_gsr"): Gap.UNKNOWN,
        # Firmware stops streaming with the end of the link.
        **{
            (kind, "shimmer3_gsr"): Gap.STOPPED
            for kind in BREAKS - {FaultKind.STALL}
        },
        # Cortex lets go of the headset, the strap is switched off: neither measures.
        (FaultKind.RESTART, "emotiv_insight"): Gap.STOPPED,
        (FaultKind.RESTART, "polar_h10"): Gap.STOPPED,
    }
)


def gap_of(kind: FaultKind, name: str) -> Gap:
    """What a fault makes of a device's measuring."""
    return _GAPS.get((kind, name), Gap.MEASURED)


def tolerance(name: str, data_name: str) -> int:
    """By how many samples the count of lost ones may be wrong.

    Emotiv's samples are numbered and stamped: exact. A Shimmer's are stamped, but some
    may be in the radio when it breaks. Those of a strap are counted by its clock, to half
    a frame's rounding. A BioHarness is restarted between two packets, which are what it
    numbers. A belt and a wristband number nothing: there, time is what is measured, to
    the delay of a packet and to 0.05 s in each window of ten seconds.
    """
    rate = float(_RATES[name, data_name])
    return {
        "empatica_e4": round(0.5 * rate) + 1,
        "emotiv_insight": 1,
        "shimmer3_gsr": 4,
        "polar_h10": 2,
        "vernier_respiration_belt": 2,
        "zephyr": _PACKETS.get(data_name, 1),
        "ble_heart_rate": 0,
    }[name]


_PACKETS = MappingProxyType({"ecg": 63, "breathing": 18, "acc": 20})


def numeric_streams(name: str) -> tuple[str, ...]:
    """Data names of all streams of numbers that a sensor has."""
    streams = (each for each in sensor(name).streams if not each.message_type.is_text)
    return tuple(each.data_name for each in streams if (name, each.data_name) not in _ABSENT)


def regular_streams(name: str) -> tuple[str, ...]:
    """Data names of those that come at a rate."""
    return tuple(each for each in numeric_streams(name) if sensor(name).stream(each).rate != 0)


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
