"""What each sensor can suffer, where it shows, and how it counts what it lost."""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType

from biosensor_common.naming import source_id
from biosensor_common.quantities import ChannelRole
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.demo.virtual_devices import one_of_each, virtual_class
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.simulation.faults import OF_A_KIND, FaultKind
from biosensor_gateway.simulation.truth import Contact, Gap
from biosensor_gateway.simulation.virtual_device import VirtualDevice


class AgentFault(Enum):
    """What happens to the agent, and so to all devices at once."""

    ASLEEP = "asleep"
    """It does not run for a while, as on a computer that sleeps or is starved."""


Kind = FaultKind | AgentFault
KINDS: tuple[Kind, ...] = (*(kind for kind in FaultKind if kind not in OF_A_KIND), *AgentFault)
"""What a device of some kinds only can have is tried beside its driver."""

SENSORS = one_of_each()
"""All that have a virtual device, those of other packages included."""


def device_of(name: str) -> type[VirtualDevice]:
    """The class of a sensor's virtual device."""
    return virtual_class(name)


CELLS = tuple(
    (kind, name)
    for kind in KINDS
    for name in SENSORS
    if kind not in device_of(name).expected.impossible
)
"""Which fault can hit which sensor."""
BREAKS = frozenset(
    {FaultKind.DROP, FaultKind.STALL, FaultKind.REFUSE, FaultKind.LATE, FaultKind.RESTART}
)
"""The connection ends with these, and has to be made again."""
MAY_BREAK = BREAKS | {AgentFault.ASLEEP, FaultKind.UNREADABLE}
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


STARTS_OF_UNREADABLE = 4
"""What nobody can read is enabled again and connected again, in turns, as long as that lasts."""
BATTERY_TOLERANCE = 1.0
"""Of a percentage: some compute it from a coarse voltage."""


def contact_of(name: str) -> Contact:
    """Where it shows whether a device is worn."""
    return device_of(name).expected.contact or Contact(*_first(name, ChannelRole.CONTACT))


def battery_of(name: str) -> tuple[str, int]:
    """Data name and column of the channel with what is left in the battery."""
    return _first(name, ChannelRole.STATE_OF_CHARGE)


def _first(name: str, role: ChannelRole) -> tuple[str, int]:
    data_name, column, _ = next(declaration(name).channels_of(role))
    return data_name, column


def without_contact(name: str) -> tuple[str, ...]:
    """Data names that have no value off the body."""
    return device_of(name).expected.without_contact


def is_by_agent(name: str, data_name: str) -> bool:
    """Whether the agent computes a stream, or decides when to send: no truth of the wire."""
    return data_name in device_of(name).expected.by_agent


def gap_of(kind: Kind, name: str) -> Gap:
    """What a fault makes of a device's measuring."""
    if isinstance(kind, AgentFault):
        return Gap.MEASURED
    return device_of(name).expected.gaps.get(kind, Gap.MEASURED)


def tolerance(kind: Kind, name: str, data_name: str) -> int:
    """By how many samples the count of those that are lost may be wrong."""
    once = device_of(name).expected.loss_tolerance.of(
        data_name,
        is_break=kind in MAY_BREAK | {FaultKind.FORGET},
        is_restart=kind is FaultKind.RESTART,
    )
    return once * STARTS_OF_UNREADABLE if kind is FaultKind.UNREADABLE else once


def never_streams(name: str) -> frozenset[str]:
    """Data names of what a virtual device has only in name, as some models do."""
    filled = device_of(name).filled.items()
    return frozenset(each for each, how in filled if how.after_s is None)


def numeric_streams(name: str) -> tuple[str, ...]:
    """Data names of all streams of numbers that a virtual device ever sends."""
    never = never_streams(name)
    streams = (each for each in declaration(name).streams if not each.message_type.is_text)
    return tuple(each.data_name for each in streams if each.data_name not in never)


def regular_streams(name: str) -> tuple[str, ...]:
    """Data names of those that come at a rate."""
    return tuple(each for each in numeric_streams(name) if declaration(name).stream(each).rate != 0)


def steady_streams(name: str) -> tuple[str, ...]:
    """Data names of those that never pause, by which one knows that a device streams."""
    # What has no regular stream says all the time whether it is worn.
    return regular_streams(name) or (contact_of(name).data_name,)


def unit_of(name: str) -> str:
    """How the settings call the device."""
    return name.upper()


def source(name: str, data_name: str) -> str:
    """The source_id of a stream."""
    return source_id(DeviceIdentity(name, unit_of(name)), data_name)
