"""Sums up each device for ``/diagnostics``, from what its own streams tell."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator

from diagnostic_msgs.msg import DiagnosticStatus

from biosensor_common.quantities import ROLES_OF_DEVICE, TYPES_OF_DEVICE, ChannelRole
from biosensor_common.stream_header import StreamHeader
from lsl_to_ros.reports.diagnostics import status
from lsl_to_ros.topics.bridge import Bridge

LOW_BATTERY_PERCENT = 10.0


def device_statuses(bridges: Iterable[tuple[str, Bridge]]) -> Iterator[DiagnosticStatus]:
    """Describe each device by battery, contact, signal, and its clock as the agent tells.

    Parameters
    ----------
    bridges
        Streams, each with its device's name as in the topics.

    Yields
    ------
    DiagnosticStatus
        WARN if a battery is at 10 % or less, or a sensor says that it is not worn.
    """
    devices: defaultdict[str, list[Bridge]] = defaultdict(list)
    for name, bridge in bridges:
        if not bridge.header.foreign and (_told(bridge.header) or bridge.counters.clock):
            devices[name].append(bridge)
    for name, told in devices.items():
        level, message = _judge(told)
        texts = dict(_texts(told))
        yield status(f"device {name}", level, message, texts, told[0].header.identity.unit)


def _texts(bridges: Iterable[Bridge]) -> Iterator[tuple[str, str]]:
    """Yield the newest values under their data and channel names, and the clock's state."""
    for bridge in bridges:
        for key, value in bridge.counters.clock.items():
            # An offset of years, to the microsecond.
            yield f"clock/{key}", f"{value:.6f}".rstrip("0").rstrip(".")
        data_name = bridge.header.data_name
        for column, value in _newest(bridge):
            yield f"{data_name}/{bridge.header.labels[column]}", f"{value:g}"


def _told(header: StreamHeader) -> list[int]:
    """Return the columns that tell of the device: all of some types of stream."""
    if header.content_type in TYPES_OF_DEVICE:
        return list(range(len(header.roles)))
    return [column for column, role in enumerate(header.roles) if role in ROLES_OF_DEVICE]


def _newest(bridge: Bridge) -> Iterator[tuple[int, float]]:
    """Yield what a stream told last of its device, with its column."""
    if bridge.newest is not None and not bridge.header.message_type.is_text:
        for column in _told(bridge.header):
            yield column, float(bridge.newest[column])


def _judge(bridges: Iterable[Bridge]) -> tuple[bytes, str]:
    for bridge in bridges:
        for column, value in _newest(bridge):
            role = bridge.header.roles[column]
            if role is ChannelRole.STATE_OF_CHARGE and value <= LOW_BATTERY_PERCENT:
                return DiagnosticStatus.WARN, f"battery at {value:g} %"
            # NaN, unknown, is neither.
            if role is ChannelRole.CONTACT and value == 0:
                return DiagnosticStatus.WARN, "not worn"
    return DiagnosticStatus.OK, "as its streams tell"
