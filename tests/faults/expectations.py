"""What each sensor can suffer, where it shows, and how exactly it counts what it lost."""

from __future__ import annotations

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
# A heart-rate strap takes no commands that it could refuse or answer late.
_COMMANDED = (FaultKind.REFUSE, FaultKind.LATE)
CELLS = tuple(
    (kind, name)
    for kind in FaultKind
    for name in SENSORS
    if (name, kind) not in {("ble_heart_rate", each) for each in _COMMANDED}
)
VALUES = MappingProxyType(
    {
        FaultKind.GARBAGE: 64.0,
        FaultKind.LATE: 1.0,
        FaultKind.LOW_BATTERY: 4.0,
        FaultKind.DRIFT: 150.0,
    }
)
"""Of those that are not in seconds; those that are last until the test ends them."""
BREAKS = frozenset(
    {FaultKind.DROP, FaultKind.STALL, FaultKind.REFUSE, FaultKind.LATE, FaultKind.RESTART}
)
"""The connection ends with these, and must be made anew."""
AT_ONCE = frozenset({FaultKind.GARBAGE, FaultKind.LOW_BATTERY, FaultKind.DRIFT})


class Channel(NamedTuple):
    """One channel of a stream, and what it holds when all is well and when it is not."""

    data_name: str
    index: int
    well: float = 1.0
    ill: float = 0.0


_CONTACT = Channel("quality", 0)
WEAR = MappingProxyType(
    {
        "empatica_e4": _CONTACT,
        "shimmer3_gsr": _CONTACT,
        "polar_h10": _CONTACT,
        "zephyr": _CONTACT,
        "ble_heart_rate": _CONTACT,
        # Of all electrodes together, in percent.
        "emotiv_insight": Channel("dev", 7, 50.0),
        # A belt that nobody wears is loose.
        "vernier_respiration_belt": Channel("quality", 1, 0.0, -1.0),
    }
)
BATTERY = MappingProxyType(
    {name: Channel("bat", 0) for name in SENSORS} | {"emotiv_insight": Channel("dev", 8)}
)
# Without contact these have no value: NaN that keeps its place, or nothing at all.
NO_VALUE = MappingProxyType(
    {
        "empatica_e4": ("gsr",),
        "emotiv_insight": (),
        "shimmer3_gsr": ("gsr", "hr"),
        "polar_h10": ("hr", "ibi"),
        "vernier_respiration_belt": ("bpm",),
        "zephyr": ("hr", "br"),
        "ble_heart_rate": ("hr", "ibi"),
    }
)
# The agent itself decides when to send these, or computes them: no truth of the wire.
OF_THE_AGENT = frozenset({("shimmer3_gsr", "hr"), *((name, "quality") for name in SENSORS)})
# Only older firmware than that of the virtual headset sends it.
_ABSENT = frozenset({("emotiv_insight", "gyro")})


def numeric_streams(name: str) -> tuple[str, ...]:
    """Data names of all streams of numbers that a sensor has."""
    streams = (each for each in sensor(name).streams if not each.message_type.is_text)
    return tuple(each.data_name for each in streams if (name, each.data_name) not in _ABSENT)


def regular_streams(name: str) -> tuple[str, ...]:
    """Data names of those that come at a rate."""
    return tuple(each for each in numeric_streams(name) if sensor(name).stream(each).rate != 0)


def steady_streams(name: str) -> tuple[str, ...]:
    """Data names of those that come all the time, by which one knows that it streams."""
    return regular_streams(name) or ("hr",)


def unit_of(name: str) -> str:
    """How the settings of the test call the device."""
    return name.upper()


def source(name: str, data_name: str) -> str:
    """The source_id of a stream."""
    return source_id(DeviceIdentity(name, unit_of(name)), data_name)
