"""``/diagnostics``: one status a device, from what its own streams tell of it."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator

from diagnostic_msgs.msg import DiagnosticStatus

from biosensor_common.quantities import ContentType, Unit
from lsl_to_ros.bridge import Bridge
from lsl_to_ros.diagnostics import status

LOW_BATTERY_PERCENT = 10.0
# Channels that are 1 while the sensor is where it should be.
_CONTACT = frozenset({"contact", "worn", "electrodes"})
_TOLD = frozenset({ContentType.BATTERY, ContentType.QUALITY, ContentType.RSSI, ContentType.STATUS})


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
        is_told = bridge.header.content_type in _TOLD or bridge.tally.clock
        if is_told and not bridge.header.foreign:
            devices[name].append(bridge)
    for name, told in devices.items():
        level, message = _judge(told)
        texts = dict(_texts(told))
        yield status(f"device {name}", level, message, texts, told[0].header.identity.unit)


def _texts(bridges: Iterable[Bridge]) -> Iterator[tuple[str, str]]:
    """Yield the newest values under their data and channel names, and the clock's state."""
    for bridge in bridges:
        for key, value in bridge.tally.clock.items():
            # An offset of years, to the microsecond.
            yield f"clock/{key}", f"{value:.6f}".rstrip("0").rstrip(".")
        for label, value in _newest(bridge).items():
            yield f"{bridge.header.data_name}/{label}", f"{value:g}"


def _newest(bridge: Bridge) -> dict[str, float]:
    """Return what a stream told last of its device, by channel."""
    header = bridge.header
    if bridge.newest is None or header.message_type.is_text or header.content_type not in _TOLD:
        return {}
    return dict(zip(header.labels, map(float, bridge.newest), strict=True))


def _judge(bridges: Iterable[Bridge]) -> tuple[bytes, str]:
    for bridge in bridges:
        header = bridge.header
        units = dict(zip(header.labels, header.units, strict=True))
        for label, value in _newest(bridge).items():
            is_level = header.content_type == ContentType.BATTERY or label == "BatteryPercent"
            if is_level and units[label] == Unit.PERCENT and value <= LOW_BATTERY_PERCENT:
                return DiagnosticStatus.WARN, f"battery at {value:g} %"
            if label in _CONTACT and not math.isnan(value) and value == 0:
                return DiagnosticStatus.WARN, "not worn"
    return DiagnosticStatus.OK, "as its streams tell"
