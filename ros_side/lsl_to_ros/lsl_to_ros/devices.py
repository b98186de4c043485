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
    """Describe each device by battery, contact and signal.

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
        if not bridge.header.foreign and bridge.header.content_type in _TOLD:
            devices[name].append(bridge)
    for name, told in devices.items():
        values = dict(_values(told))
        level, message = _judge(told)
        texts = {key: f"{value:g}" for key, value in values.items()}
        yield status(f"device {name}", level, message, texts, told[0].header.identity.unit)


def _values(bridges: Iterable[Bridge]) -> Iterator[tuple[str, float]]:
    """Yield the newest values under their data and channel names."""
    for bridge in bridges:
        if bridge.newest is not None and not bridge.header.message_type.is_text:
            for label, value in zip(bridge.header.labels, bridge.newest, strict=True):
                yield f"{bridge.header.data_name}/{label}", float(value)


def _judge(bridges: Iterable[Bridge]) -> tuple[bytes, str]:
    for bridge in bridges:
        if bridge.newest is None or bridge.header.message_type.is_text:
            continue
        header = bridge.header
        for label, unit, value in zip(header.labels, header.units, bridge.newest, strict=True):
            is_level = header.content_type == ContentType.BATTERY or label == "BatteryPercent"
            if is_level and unit == Unit.PERCENT and value <= LOW_BATTERY_PERCENT:
                return DiagnosticStatus.WARN, f"battery at {value:g} %"
            if label in _CONTACT and not math.isnan(value) and value == 0:
                return DiagnosticStatus.WARN, "not worn"
    return DiagnosticStatus.OK, "as its streams tell"
