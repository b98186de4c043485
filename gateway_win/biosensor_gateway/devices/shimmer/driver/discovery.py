"""Recognises a Shimmer's Bluetooth serial port by the name on the case."""

from __future__ import annotations

import re

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

_NAME = re.compile(r"Shimmer3R?-([0-9A-Fa-f]{4})(?:-BT)?")


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Return how to add a paired Shimmer; its unit is the number on the case."""
    if not isinstance(seen, SerialPort):
        return None
    name = _NAME.fullmatch(seen.remote_name)
    if name is None:
        return None
    settings = {"unit": name[1].upper(), "port": seen.port}
    return Found("shimmer", seen.remote_name, settings)
