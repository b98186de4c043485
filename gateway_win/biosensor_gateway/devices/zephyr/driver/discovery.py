"""Recognises a BioHarness' Bluetooth serial port by the serial number in its name."""

from __future__ import annotations

import re

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

_NAME = re.compile(r"BH ?([A-Z]{3}[0-9]{6})")


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Return how to add a paired BioHarness; its unit is its serial number."""
    if not isinstance(seen, SerialPort):
        return None
    name = _NAME.fullmatch(seen.remote_name)
    if name is None:
        return None
    return Found("zephyr", seen.remote_name, {"unit": name[1], "port": seen.port})
